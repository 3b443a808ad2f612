"""A trade-off is chosen by what its policy must reach, and its policy does reach it."""

import shlex
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch
from acting import episode
from closed_form import PLACES, Quadratic

from morlax_torch import MorlaxError, Policy, config_for, envs, load, save
from morlax_torch.__main__ import COMMANDS
from morlax_torch.__main__ import command as run_command
from morlax_torch.commands import choose as choose_command
from morlax_torch.commands.terminal import cli
from morlax_torch.configuration.tradeoffs import parse_tradeoff
from morlax_torch.evaluation.evaluator import evaluation_worlds
from morlax_torch.evaluation.front import Front
from morlax_torch.evaluation.requirements import Requirements, index_of
from morlax_torch.networks.agent import Agent
from morlax_torch.reports import page
from morlax_torch.runs import choosing, loading
from morlax_torch.runs.checkpoint import Task
from morlax_torch.runs.choosing import Candidates, Chooser, Trial, choose, trials
from morlax_torch.runs.loading import bookmark, evaluate, find_run, tradeoff_of

# of the way from the right place to the left one of `Quadratic`, of three separate policies
SHARES = torch.tensor([0.0, 0.4, 1.0])


class Certain(Quadratic):
    """`Quadratic`, and known to have nothing random."""

    class Options(Quadratic.Options):
        varies: ClassVar[bool] = False


class Gusty(Quadratic):
    """`Quadratic` with normal noise on both returns."""

    def step(self, action):
        step = super().step(action)
        noise = torch.randn(step.reward.shape, generator=self.generator)
        return step._replace(reward=step.reward + 0.1 * noise)


class Powered(Certain):
    """`Certain` in two equal steps, which measures its place along x."""

    episode_length = 2
    quantities = ("power (W)", "speed (m/s)", "speed (share)")
    lower_is_better = ("power (W)",)

    def __init__(self, *given):
        super().__init__(*given)
        self.x, self.age = torch.zeros(self.num_worlds), 0

    def reset(self):
        self.age = 0
        return super().reset()

    def step(self, action):
        self.x, self.age = action[:, 0], self.age + 1
        step = super().step(action)
        over = step.terminated & (self.age == self.episode_length)
        return step._replace(reward=step.reward / self.episode_length, terminated=over)

    def measure(self):
        return self.x[:, None]

    def quantify(self, means, falls):
        (x,) = means.T
        return np.stack([100 * x**2, 1 + x, x], 1)


@pytest.fixture
def typed(monkeypatch, capsys):
    """Return a function that runs the command on the CPU, and returns the lines it prints."""

    def run(*words: object) -> list[str]:
        monkeypatch.setattr("sys.argv", ["choose", *map(str, words), "--device", "cpu"])
        cli.run(choose_command.command)
        return capsys.readouterr().out.splitlines()

    return run


@pytest.fixture
def three(tmp_path) -> Path:
    """Return a run with three separate policies: the trade-off only selects one of them."""
    return separate(tmp_path / "run", "certain", Certain)


def separate(folder: Path, name: str, task: type[Quadratic]) -> Path:
    envs.register(name, task)
    changes = {"network.type": "independent", "sampling.clusters": len(SHARES), "device": "cpu"}
    changes |= {"algorithm": "independent", "network.actor": (), "evaluation.tradeoffs": 11}
    config = config_for(name, **changes, worlds=4 * len(SHARES))
    objectives = "left", "right"
    agent = Agent(config, Task(objectives=objectives, observation_size=1, action_size=2))
    actions = SHARES[:, None] * PLACES[0] + (1 - SHARES[:, None]) * PLACES[1]
    bias = torch.cat([actions.atanh(), torch.zeros(len(SHARES), 2)], 1)
    with torch.no_grad():
        rows = agent.actor.get_parameter("rows").zero_()
        rows[:, -4:] = bias
    policy = Policy(agent, config, objectives)
    (folder / "checkpoints").mkdir(parents=True)
    save(policy, folder / "checkpoints" / "best.pt")
    evaluate(policy, device="cpu", seeds=1).save(folder / "front.npz")
    return folder


def simulated(policy: Policy, tradeoff: tuple[float, ...]) -> list[float]:
    """Return the returns (m,) of one episode, in a loop of its own."""
    task = policy.config.task.for_evaluation().model_dump()
    env = envs.make(policy.config.env, 1, "cpu", auto_reset=False, **task)
    return episode(env, lambda observation: policy(observation, tradeoff))[0]


@pytest.fixture
def circle() -> Front:
    """Return 11 trade-offs whose returns lie on a quarter circle."""
    weights = np.linspace(0, 1, 11)
    angle = np.arctan2(weights, 1 - weights)
    returns = 100 * np.stack([np.sin(angle), np.cos(angle)], 1)
    points = np.stack([weights, 1 - weights], 1)
    return Front(("run", "save"), points, returns, np.full(11, 9), np.zeros(2), np.zeros(11))


@pytest.fixture
def powered(tmp_path) -> Path:
    """Return a run like `three`, whose policies need 25, 1 and 25 W at 1.5, 1.1 and 0.5 m/s."""
    return separate(tmp_path / "run", "powered", Powered)


@pytest.fixture
def measured(circle) -> Front:
    """Return the circle with the power of running: 0 to 100 W, the same in kW, and a gap."""
    power = circle.returns[:, :1] ** 2 / 100
    gap = np.where(np.arange(11) == 3, np.nan, 1.0)[:, None]
    values = np.hstack([power, power / 1000, gap])
    names = ("power (W)", "power (kW)", "gap (m)")
    return circle._replace(quantities=values, quantity_names=names)


@pytest.mark.parametrize("least", [0.0, 33.0, 99.0])
def test_of_a_front_the_best_evaluated_policy_is_chosen(circle, least):
    found = choose(circle, {"run": least}, "save")
    reached = circle.returns[circle.returns[:, 0] >= least]
    assert list(found.returns.values()) == reached[reached[:, 1].argmax()].tolist()
    (index,) = (circle.tradeoffs == found.tradeoff).all(1).nonzero()[0]
    assert circle.returns[index].tolist() == list(found.returns.values())
    assert found.returns == found.promised and found.simulated == 0
    assert found.margins == {"run": found.returns["run"] - least}
    assert found.cost == pytest.approx(100 - found.returns["save"])


def test_a_margin_is_a_share_of_the_range(circle):
    free = choose(circle, {}, "run")
    assert free.returns["run"] == pytest.approx(100)
    assert free.cost == 0 and free.margins == {}
    assert choose(circle, {"run": 70.0}, "save").returns["run"] == pytest.approx(70.7, abs=0.1)
    assert choose(circle, {"run": 70.0}, "save", margin=0.05).returns["run"] >= 75


def test_of_a_front_as_much_as_a_quantity_allows(measured):
    found = choose(measured, {}, "run", at_most={"power (W)": 60.0})
    power = measured.quantities[:, 0]
    best = power[power <= 60].max()
    assert found.returns["run"] == pytest.approx(10 * best**0.5)
    assert found.quantities["power (W)"] == best
    assert found.margins == {"power (W)": 60 - best}
    assert found.cost == pytest.approx(100 - found.returns["run"])
    assert list(found.promised) == ["run", "save"]
    tight = choose(measured, {}, "run", at_most={"power (W)": 60.0}, margin=0.1)
    assert tight.quantities["power (W)"] <= 50


def test_a_quantity_that_is_not_finite_keeps_no_requirement(measured):
    found = choose(measured, {"gap": 0.5}, "save", at_most={"run": 50.0})
    assert found.quantities["gap (m)"] == 1
    assert (measured.tradeoffs[3] != found.tradeoff).any()
    third = choose(measured, {}, "save", at_most={"save": float(measured.returns[3, 1])})
    assert third.tradeoff == tuple(measured.tradeoffs[3])
    without = measured._replace(quantities=np.full((11, 3), np.nan))
    returns = [choose(front, {"run": 50.0}, "save").returns for front in (without, measured)]
    assert returns[0] == returns[1]
    message = "no policy has finite numbers for run and save and power .W.: choose"
    with pytest.raises(MorlaxError, match=message):
        choose(without, {}, "run", at_most={"power (W)": 60.0})


def test_a_name_needs_no_unit_where_it_is_clear():
    names = ("run", "power"), ("power (W)", "speed (m/s)", "speed (share)", "torque (N m)")
    values = {"power": 1, "power (W)": 2, "torque": 5, "torque (N m)": 5}
    assert {name: index_of(name, *names) for name in values} == values
    message = r"^'speed' is ambiguous: write 'speed \(m/s\)' or 'speed \(share\)'\.$"
    with pytest.raises(MorlaxError, match=message):
        index_of("speed", *names)
    with pytest.raises(MorlaxError, match="objective or quantity 'runn': did you mean 'run'"):
        index_of("runn", *names)


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(("limit", "least"), [(25.0, 49.0), (81.0, 83.2)])
def test_the_search_meets_a_limit_beside_policies_without_numbers(measured, limit, least, broken):
    """The most that 25 W allow is to run 50. Near 81 W, nothing is measured: 83.2 is evaluated."""

    def simulate(tradeoffs: np.ndarray) -> np.ndarray:
        returns = 100 * tradeoffs / np.linalg.norm(tradeoffs, axis=1, keepdims=True)
        power = returns[:, :1] ** 2 / 100
        return np.hstack([returns, np.where(abs(power - 81) < 5, broken, power)])

    names = ("run", "save"), ("power (W)",)
    required = Requirements.of(*names, {}, "run", {"power": limit})
    candidates = Candidates(measured.tradeoffs, measured.values[:, :3], False, required)
    for _ in range(8):
        proposed, promised, chance = candidates.propose(8)
        assert np.isfinite(promised).all() and 0 <= chance <= 1
        candidates.tell(proposed, promised, simulate(proposed))
    best = candidates.values[candidates.ranked()[0]]
    assert least <= best[0] <= 10 * limit**0.5 and best[2] <= limit


@pytest.mark.parametrize("given", ["run", "policy"])
def test_separate_policies_keep_what_is_promised(three, given):
    """Returns between (0, 1) and (0.64, 0.84) can be interpolated, but no policy has them."""
    policy = load(three)
    found = choose(three if given == "run" else policy, {"left": 0.4}, "right", device="cpu")
    assert simulated(policy, found.tradeoff) == list(found.returns.values())
    assert list(found.returns.values()) == pytest.approx([0.64, 0.84], abs=1e-5)
    assert found.cost == pytest.approx(0.16, abs=1e-5)
    assert found.simulated <= 2 * 64  # the second batch shows that nothing more is to be found


def test_what_no_separate_policy_reaches_is_refused(three):
    """The line between two of them promises 0.91 and 0.21."""
    message = (
        "no simulated policy keeps every requirement: the nearest, with the trade-off "
        r"[\d.]+,[\d.]+, has right \S+ instead of 0.2, 0.2 less"
    )
    with pytest.raises(MorlaxError, match=message):
        choose(three, {"left": 0.9, "right": 0.2}, "right", device="cpu")


@pytest.mark.parametrize("given", ["run", "policy", "front without quantities"])
def test_a_measured_quantity_is_kept_in_simulation(powered, given):
    if given == "front without quantities":
        front = Front.load(powered / "front.npz")
        front._replace(quantities=None, quantity_names=()).save(powered / "front.npz")
    run = load(powered) if given == "policy" else powered
    found = choose(run, {}, "right", at_most={"power": 10.0}, device="cpu")
    assert list(found.returns.values()) == pytest.approx([0.64, 0.84], abs=1e-5)
    expected = {"power (W)": 1.0, "speed (m/s)": 1.1, "speed (share)": 0.1}
    assert found.quantities == pytest.approx(expected, abs=1e-5)
    assert found.margins == pytest.approx({"power (W)": 9.0}, abs=1e-4)
    assert found.cost == pytest.approx(0.16, abs=1e-5)
    fastest = choose(run, {"left": 0.4}, "speed (m/s)", device="cpu")
    assert fastest.quantities["speed (m/s)"] == pytest.approx(1.1)
    message = r"has power \(W\) 1 instead of at most 0.5, 0.5 more\.$"
    with pytest.raises(MorlaxError, match=message):
        choose(run, {}, "right", at_most={"power": 0.5}, device="cpu")


@pytest.mark.parametrize("seed", [0, 2**63 - 1])
def test_a_random_task_keeps_its_requirement_on_fresh_episodes(tmp_path, seed):
    run = separate(tmp_path / "run", "gusty", Gusty)
    least = 0.62  # 0.02 less than the second policy's, where few episodes could show the first's
    found = choose(run, {"left": least}, "right", margin=0.0, seed=seed, device="cpu")
    env = evaluation_worlds(load(run).config, 1, 4000, 77)
    reward = env.step(load(run)(env.reset(), found.tradeoff)).reward.mean(0)
    assert reward[0] >= least - 0.01
    assert reward.tolist() == pytest.approx(list(found.returns.values()), abs=0.06)


def test_other_episodes_decide_than_those_that_chose_the_finalists(tmp_path, monkeypatch):
    """Search episodes pay up to 1 more by luck, and what they earn is not told."""
    run = separate(tmp_path / "run", "gusty", Gusty)
    chooser, finalists = Chooser(load(run), None), []

    def simulate(_chooser, evaluator, tradeoffs: np.ndarray) -> np.ndarray:
        right = 1 - (tradeoffs[:, 0] - 0.3) ** 2
        if evaluator is chooser._evaluator:
            right = right + 61_803 * tradeoffs[:, 0] % 1
        else:
            assert evaluator._seed != chooser._evaluator._seed
            finalists.extend(tradeoffs.tolist())
        return np.stack([tradeoffs[:, 0], right], 1)

    monkeypatch.setattr(Chooser, "_simulate", simulate)
    found = chooser.choose({"left": 0.1}, "right", margin=0.0)
    kept = [tradeoff for tradeoff in finalists if tradeoff[0] >= 0.1]
    best = min(kept, key=lambda tradeoff: abs(tradeoff[0] - 0.3))
    assert len({tuple(tradeoff) for tradeoff in kept}) > 3
    assert list(found.tradeoff) == best != kept[0]
    assert found.returns == pytest.approx({"left": best[0], "right": 1 - (best[0] - 0.3) ** 2})


def test_a_requirement_is_kept_even_if_all_of_the_best_were_lucky(tmp_path, monkeypatch):
    run = separate(tmp_path / "run", "gusty", Gusty)
    chooser = Chooser(load(run), None)

    def simulate(_chooser, evaluator, tradeoffs: np.ndarray) -> np.ndarray:
        luck = 0.3 if evaluator is chooser._evaluator else 0.0
        return np.stack([tradeoffs[:, 0] + luck, 1 - tradeoffs[:, 0]], 1)

    monkeypatch.setattr(Chooser, "_simulate", simulate)
    choice = chooser.choose({"left": 0.5}, "right")
    assert 0.5 <= choice.returns["left"] < 0.7


@pytest.mark.slow
def test_the_search_comes_close_to_a_dense_scan(three, monkeypatch):
    """Near trade-offs of a robot that hops differ by chance, so few are better than all others."""
    random = np.random.default_rng(0)
    share = np.linspace(0, 1, 20_001)
    smooth = np.stack([share, 1 - share], 1) ** 0.5
    every = 1000 * (2 + smooth + random.normal(scale=0.02, size=smooth.shape))

    def simulate(_chooser, _evaluator, tradeoffs: np.ndarray) -> np.ndarray:
        return every[np.rint(20_000 * tradeoffs[:, 0]).astype(int)]

    monkeypatch.setattr(Chooser, "_simulate", simulate)
    some, dense = np.arange(0, 20_001, 40), every[::5]
    weights = np.stack([share, 1 - share], 1)[some]
    lengths, falls = np.ones(len(some)), np.zeros(len(some))
    front = Front(("left", "right"), weights, every[some], lengths, np.zeros(2), falls)
    chooser = Chooser(load(three), front)
    losses = []
    for _ in range(8):
        required, maximized = random.permutation(2)
        least = random.uniform(*np.quantile(every[some, required], (0.2, 0.8)))
        names = front.objectives[required], front.objectives[maximized]
        found = chooser.choose({names[0]: least}, names[1])
        assert found.returns[names[0]] >= least
        best = dense[dense[:, required] >= least, maximized].max()
        losses.append(1 - found.returns[names[1]] / best)
    assert max(losses) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "constraints", "maximize"),
    [
        ("hopper", {"run": 3483.0}, "jump"),
        pytest.param(
            "cheetah3", {"run": 1800.0, "height": 1500.0}, "energy", marks=pytest.mark.long
        ),
    ],
)
def test_the_printed_policy_keeps_its_requirements(name, constraints, maximize, monkeypatch):
    monkeypatch.setattr(choosing, "MOST_BATCHES", 4)
    found = choose(name, constraints, maximize, device="cpu")
    policy = load(name)
    text = ",".join(f"{weight:.6g}" for weight in found.tradeoff)
    again = simulated(policy, parse_tradeoff(text, policy.objectives))
    assert dict(zip(policy.objectives, again, strict=True)) == found.returns
    for objective, least in constraints.items():
        assert found.returns[objective] >= least
        assert found.margins[objective] == pytest.approx(found.returns[objective] - least)
    some = evaluate(policy, 64, device="cpu")
    limits = np.array([constraints.get(objective, -np.inf) for objective in policy.objectives])
    kept = some.returns[(some.returns >= limits).all(1)]
    index = policy.objectives.index(maximize)
    assert found.returns[maximize] >= 0.99 * kept[:, index].max()
    assert found.cost >= 0


MISTAKES = {
    "an unknown objective": ({"rum": 1.0}, "save", "unknown objective 'rum': did you mean 'run'"),
    "no quantities": ({"power": 1.0}, "save", r"'power'.* No quantities are measured"),
    "not a number": ({"run": float("nan")}, "save", "required value of run is nan"),
    "a text": ({"run": "90"}, "save", "required value of run is 90: use a number"),
    "too much at once": (
        {"run": 90.0, "save": 90.0},
        "run",
        r"the nearest, with the trade-off 0.5,0.5, has run 70.7\d* instead of 90, 19.3 less and "
        r"save 70.7\d* instead of 90, 19.3 less",
    ),
}


@pytest.mark.parametrize(("constraints", "maximize", "message"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_one_sentence(circle, constraints, maximize, message):
    with pytest.raises(MorlaxError, match=message):
        choose(circle, constraints, maximize)


def test_numbers_out_of_range_are_refused(circle):
    with pytest.raises(MorlaxError, match=r"margin is -0\.1: it must be from 0 to 1"):
        choose(circle, {"run": 1.0}, "save", margin=-0.1)
    with pytest.raises(MorlaxError, match="of a Front alone: leave seeds out"):
        choose(circle, {"run": 1.0}, "save", seeds=8)
    with pytest.raises(MorlaxError, match="would only repeat the same episode"):
        choose("cheetah", {}, "run", seeds=2, device="cpu")


def test_the_largest_requirement_of_an_objective_counts(three, typed):
    required = "--at-least", "left=0.1", "--at-least", "left=0.4"
    lines = typed(three, *required, "--maximize", "right")
    assert next(x for x in lines if x.split()[0] == "left").split()[3] == "0.4"


@pytest.mark.parametrize(
    ("option", "text", "remedy"),
    [
        ("--at-least", "run > 3", "run=2000"),
        ("--at-most", "run=nan", "power=60"),
        ("--at-least", "=3", "run=2000"),
        ("--at-most", "power (W)=inf", "power=60"),
    ],
)
def test_a_requirement_that_cannot_be_read_is_refused(option, text, remedy, refused):
    said = refused(choose_command, "cheetah", option, text, "--maximize", "energy")
    assert said == f"error: {text!r} names no number: write for example {option} {remedy}.\n"


def test_the_command_limits_a_quantity(powered, typed):
    printed = typed(powered, "--at-most", "power=10", "--maximize", "speed (m/s)")
    lines = [line.split("  ") for line in printed]
    cells = {line[0].strip(): [x.strip() for x in line[1:] if x.strip()] for line in lines}
    assert cells["power (W)"] == ["1", "at most 10", "+9"]
    assert cells["speed (m/s)"] == ["1.1"] and len(cells["right"]) == 2
    assert "speed (share)" not in cells
    assert ["cost of the requirements: 0.4 of speed (m/s), which reaches 1.5 without them"] in lines


def test_without_a_gpu_a_task_that_needs_one_is_not_simulated(monkeypatch, typed):
    monkeypatch.setattr(envs.get("cheetah"), "needs_gpu", True)
    printed = "\n".join(typed("cheetah", "--maximize", "energy", "--at-least", "run=1000"))
    assert "evaluated" in printed and "simulated" not in printed
    chosen = parse_tradeoff(printed.split("trade-off: ")[1].split()[0], ("run", "energy"))
    expected = choose(Front.load(find_run("cheetah") / "front.npz"), {"run": 1000}, "energy")
    assert chosen == pytest.approx(expected.tradeoff, abs=1e-4)
    with pytest.raises(MorlaxError, match="leave seeds out"):
        choose("cheetah", {}, "energy", seeds=3, device="cpu")


def test_only_commands_that_work_for_the_run_are_printed(three, typed):
    """A task without a MuJoCo robot can neither be shown nor exported."""
    card = three / "card.html"
    lines = typed(three, "--maximize", "right", "--card", card)
    printed = [x.split(": ", 1)[1] for x in lines if "morlax_torch " in x or "morlax " in x]
    assert printed and all(line in card.read_text() for line in printed)
    for line in printed:
        words = shlex.split(line)
        name = next(i for i, word in enumerate(words) if word in COMMANDS)
        run_command(words[name:])


def test_a_decision_card_counts_quantities(measured, monkeypatch):
    limits = {"power (W)": 60.0}
    choice = choose(measured, {"save": 10.0}, "run", at_most=limits)
    fallen = measured._replace(falls=np.full(len(measured.returns), 0.25))
    assert (choice.falls, choose(fallen, {}, "run").falls) == (0.0, 0.25)
    worse = choice.values + np.array([0, 0, 30, 0, 0])
    tried = {"calm": Trial(choice.values, 0.0, 4), "storm": Trial(worse, 0.0, 4)}
    tried["gale"] = Trial(choice.values, 0.25, 4)  # a fall breaks a requirement
    monkeypatch.setattr(page, "trials", lambda *told: tried)
    monkeypatch.setattr(envs.get("cheetah"), "titles", {"save": "fuel saved"})
    text = page.card("cheetah", load("cheetah"), choice, [], lambda *told: None)
    wish = "As much run as possible, with at least 10 of fuel saved and at most 60 of power (W)"
    assert wish in text
    assert "<td>at most 60</td>" in text and "power (kW)" not in text
    assert "<th>evaluated</th>" in text and "No trade-offs were simulated." in text  # of a front
    assert "The requirements are not kept with storm, gale." in text
    assert text.count("<td>yes</td>") == 1 and text.count("<td>no</td>") == 2


def test_a_bookmark_stands_for_its_tradeoff(tmp_path, make_run):
    run = make_run(tmp_path / "run", "hopper", "best")
    file = bookmark(run, "calm one", (0.25, 0.75))
    bookmark(run, "fast", (3.0, 1.0))
    assert file.read_text() == "calm one: [0.25, 0.75]\nfast: [3.0, 1.0]\n"
    assert tradeoff_of("@calm one", run) == (0.25, 0.75)
    assert tradeoff_of("0.8,0.2", run) == (0.8, 0.2)
    with pytest.raises(MorlaxError, match=r"unknown bookmark of .*'fsat': did you mean 'fast'"):
        tradeoff_of("@fsat", run)
    with pytest.raises(MorlaxError, match="cannot name a bookmark"):
        bookmark(run, "../fast", (1.0, 0.0))
    with pytest.raises(MorlaxError, match="shipped policies keep no bookmarks"):
        bookmark("hopper", "fast", (1.0, 0.0))
    with pytest.raises(MorlaxError, match="there is a bookmark fast already: delete it first"):
        loading.rename_bookmark(run, "calm one", "fast")
    with pytest.raises(MorlaxError, match="there is a bookmark fast already: delete it first"):
        bookmark(run, "fast", (0.0, 1.0), replaces=False)
    assert loading.bookmarks(run) == {"calm one": [0.25, 0.75], "fast": [0.75, 0.25]}
    damages = "[a]", "[0, 0]", "[-1, 2]", "[1, 0, 0]", "[.nan, 1]", "[1, .nan]", "[.inf, 1]"
    for damage in damages:
        file.write_text(f"fast: {damage}")
        with pytest.raises(MorlaxError, match=r"weights of run, jump, .*calm: \[0.5, 0.5\]"):
            loading.bookmarks(run)
        with pytest.raises(MorlaxError, match="is damaged"):  # before `choose` simulates
            loading.check_bookmark(run, "new")


def test_the_command_writes_a_bookmark_and_a_decision_card(
    tmp_path, make_run, monkeypatch, typed, refused
):
    monkeypatch.setattr(choosing, "MOST_BATCHES", 2)
    run, card = make_run(tmp_path / "run", "hopper", "best"), tmp_path / "card.html"
    words = run, "--maximize", "run"
    written = "--at-least", "jump=-1e6", "--bookmark", "my best", "--card", card
    said, page = "\n".join(typed(*words, *written)), card.read_text()
    assert "--tradeoff '@my best'" in said and f"written: {card}" in said.replace("\n", "")
    weights = next(x for x in said.splitlines() if x.startswith("trade-off: ")).split()[1]
    chosen = tradeoff_of("@my best", run)
    assert chosen == pytest.approx(parse_tradeoff(weights, ("run", "jump")))
    assert "As much run as possible, with at least -1e+06 of jump" in page
    for condition in ("as in evaluations", "pushes of 0.5 m/s", "friction times 0.5 to 1.5"):
        assert condition in page
    assert "<td>100%</td><td>no</td>" in page and "<td>yes</td>" not in page
    assert "The requirements are not kept with as in evaluations, other starts" in page
    fallen = "falls: in 100% of its episodes, which the values above include; in these"
    assert f"{fallen} it keeps no requirement" in said.replace("\n", " ")
    simulated = next(x.split()[2] for x in said.splitlines() if x.split()[:1] == ["run"])
    assert f"<td>{float(simulated):,.4g}</td>" in page
    assert str(run / "checkpoints/best.pt") in page and "export" in page
    page = tmp_path / "card.pdf"
    assert "must end in .html" in refused(choose_command, *words, "--card", page)
    assert "cannot make" in refused(choose_command, *words, "--card", card / "card.html")
    assert "cannot name a bookmark" in refused(choose_command, *words, "--bookmark", "a/b")
    for unused in (["--output", "a.yaml"], ["--knots", "9"], ["--slew", "1"]):
        assert f"{unused[0]} is for" in refused(choose_command, *words, *unused)
    schedule = ["--over-time", "--output", "a.json"]
    assert "a.json must end in .yaml" in refused(choose_command, *words, *schedule)


def test_trials_repeat_the_evaluation_and_vary_the_robot():
    policy = load("cheetah")
    policy.config = policy.config.with_task(episode_length=200)
    tried = trials(policy, (0.5, 0.5))
    front = evaluate(policy, tradeoffs=3, device="cpu")
    usual = tried.pop(choosing.USUAL)
    assert usual.episodes == 1
    np.testing.assert_allclose(usual.values, front.returns[1], rtol=0.05)
    assert set(tried) == set(choosing.CONDITIONS)
    for trial in tried.values():
        assert trial.episodes == choosing.EPISODES and not np.allclose(trial.values, usual.values)
