"""Bodies that differ: each world's is that of its design, and one family of policies knows all."""

import re
from operator import attrgetter
from pathlib import Path
from queue import Queue
from typing import Any

import designs as comparing
import matplotlib.pyplot as plt
import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import torch
from browsing import PATIENCE, View, chromium, exploring
from same import assert_same, csv_rows
from tiny import learner as learner_of
from tiny import scaled

import morlax_torch
from morlax_torch import MorlaxError, envs
from morlax_torch.commands import design as searching
from morlax_torch.commands import record
from morlax_torch.envs.physics.mujoco import MODEL_FIELDS
from morlax_torch.envs.physics.warp import WarpPhysics
from morlax_torch.envs.robots.designed import DesignedHopper
from morlax_torch.envs.worlds import design_space
from morlax_torch.envs.worlds.design_space import DesignParameter, DesignSpace, compile_bank
from morlax_torch.evaluation import figures
from morlax_torch.evaluation.evaluator import Evaluator, held_out, make_evaluator
from morlax_torch.reports import page
from morlax_torch.runs.loading import evaluate
from morlax_torch.runs.training import Session
from morlax_torch.train import train
from morlax_torch.tuning.designs import Designer
from morlax_torch.viewers.explorer.exhibits import RunExhibit
from morlax_torch.viewers.explorer.library import choose
from morlax_torch.viewers.filming.recording import Film

TASKS = ("design/hopper", "design/cheetah", "design/ant")
SMALL = {
    "device": "cpu",
    "worlds": 16,
    "horizon": 5,
    "max_env_steps": 480,
    "sampling.clusters": 4,
    "sampling.designs": 8,
    "ppo.minibatches": 1,
    "evaluation.tradeoffs": 5,
    "evaluation.designs": 3,
}


def small(task: str = "design/hopper", **changes):
    return morlax_torch.config_for(task, **{**SMALL, **changes})


def bank_of(env, number: int = 12):
    return compile_bank(env, DesignSpace(env.designs).spread(number, seed=3))


@pytest.mark.parametrize("task", TASKS)
def test_the_default_body_is_that_of_the_usual_robot(task):
    usual = envs.make({"design/cheetah": "cheetah3"}.get(task, task[7:]), 1, "cpu", "mujoco")
    model, other = (env.physics.model for env in (envs.make(task, 1, "cpu", "mujoco"), usual))
    for name in MODEL_FIELDS:
        if not name.startswith("opt."):
            np.testing.assert_allclose(getattr(model, name), getattr(other, name), atol=1e-12)


@pytest.mark.parametrize("task", TASKS)
def test_a_world_on_warp_has_the_numbers_of_its_design(task):
    env = envs.make(task, 3, "cpu", "warp")
    bank = bank_of(env)
    env.adopt(bank)
    rows = torch.tensor([5, 0, 5])
    env.embody(rows, torch.ones(3, dtype=torch.bool))
    mine = env.physics._model
    for world, row in enumerate(rows.tolist()):
        exact = mjw.put_model(bank.models[row])
        for name, value in vars(exact).items():
            if hasattr(value, "numpy") and name != "dof_length":  # of robots that sleep
                own = getattr(mine, name).numpy()
                alone = value.numpy()
                own = own[world : world + 1] if len(own) == 3 and len(alone) == 1 else own
                assert np.array_equal(own, alone), name


@pytest.mark.parametrize("task", TASKS)
def test_a_world_moves_as_one_that_is_compiled_alone(task, backend):
    env = envs.make(task, 3, "cpu", backend, deterministic=backend == "warp")
    bank = bank_of(env)
    env.adopt(bank)
    env.embody(torch.tensor([1, 7, 4]), torch.ones(3, dtype=torch.bool))
    random = torch.Generator().manual_seed(0)
    actions = torch.rand(200, 1, env.action_size, generator=random) * 2 - 1
    one = {"backend": backend, "deterministic": backend == "warp"}
    designs = [DesignSpace(env.designs).named(bank.designs[row]) for row in (1, 7, 4)]
    alone = [envs.make(task, 1, "cpu", design=design, **one) for design in designs]
    for action in actions:
        step = env.step(action.expand(3, -1))
        steps = [each.step(action) for each in alone]
        for world, other in enumerate(steps):
            for name in ("observation", "reward"):
                found, expected = getattr(step, name)[world], getattr(other, name)[0]
                torch.testing.assert_close(found, expected, atol=1e-6, rtol=1e-6)
            assert step.terminated[world] == other.terminated[0]


class Stump(DesignedHopper):
    """Some of its designs do not compile, some start in the floor."""

    designs = {"thigh": DesignParameter(0.33, -0.3, 3.0)}

    @classmethod
    def shape(cls, spec, design):
        geom = spec.geom("thigh")
        geom.fromto, spec.body("calf").pos[2] = [0, 0, 0, 0, 0, -design["thigh"]], -design["thigh"]
        if design["thigh"] < 0:
            geom.size[0] = -1


def test_designs_without_a_body_are_left_out_and_counted(monkeypatch):
    env = envs.make("design/hopper", 1, "cpu", "mujoco")
    monkeypatch.setattr(env, "__class__", Stump)
    bank = compile_bank(env, np.array([[-0.1], [0.3], [2.0], [0.35]]))
    assert bank.designs.ravel().tolist() == [0.3, 0.35]
    assert bank.kept.tolist() == [False, True, False, True]
    with pytest.raises(MorlaxError, match=r"Stump: none of 1 designs makes a body: .*size"):
        compile_bank(env, np.array([[-0.1]]))
    with pytest.raises(MorlaxError, match="start in the floor or in themselves"):
        compile_bank(env, np.array([[2.0]]))


def test_a_parameter_needs_bounds_around_its_default():
    for low, high in ((0.1, float("inf")), (0.5, 0.9)):
        with pytest.raises(MorlaxError, match="needs finite bounds, and a default between them"):
            DesignSpace({"shin": DesignParameter(0.3, low, high)})


@pytest.mark.parametrize(
    ("design", "sentence"),
    [
        (None, r"a design is numbers by name, such as \{'thigh': 0\.33\}, not None\."),
        ({"thigh": np.zeros(3)}, r"the design parameter 'thigh' must be a number, not array"),
        ({"thigh": float("nan")}, r"'thigh' is nan m: it must be from 0\.2 to 0\.5 m"),
        ({"shin": 0.3}, r"unknown design parameter 'shin'"),
    ],
)
def test_a_wrong_design_is_one_sentence(design, sentence):
    hopper = envs.get("design/hopper")
    with pytest.raises(MorlaxError, match=sentence):
        design_space.compiled(hopper, design)
    design_space.compiled(hopper, {"thigh": np.float32(0.3), "calf": torch.tensor(0.3)})


@pytest.mark.parametrize("field", ["geom_condim", "mesh_vert", "opt.gravity", "opt.density"])
def test_what_warp_shares_between_worlds_is_named(field):
    cube = "-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 1"
    xml = f"""<mujoco><asset><mesh name="cube" vertex="{cube}" scale=".1 .1 .1"/></asset>
      <worldbody><body><freejoint/><geom type="mesh" mesh="cube"/></body></worldbody></mujoco>"""
    models = [mujoco.MjModel.from_xml_string(xml) for _ in range(3)]
    values = attrgetter(field)
    if field == "opt.density":
        models[2].opt.density = 1000
    else:
        values(models[2])[0] += 1
    physics = WarpPhysics(models[0], 2, torch.device("cpu"), 1, nconmax=1, njmax=1)
    physics.keep([models[1], models[0]])  # alike
    with pytest.raises(MorlaxError, match=f"MuJoCo Warp cannot vary '{field}' between worlds"):
        physics.keep(models)


def test_bodies_and_randomized_models_exclude_each_other():
    env = envs.make("design/hopper", 2, "cpu", "mujoco", randomization={"mass": (0.9, 1.1)})
    with pytest.raises(MorlaxError, match=r"task\.randomization cannot change"):
        env.adopt(bank_of(env, 2))


def test_noisy_starts_are_those_of_the_own_body():
    env = envs.make("design/ant", 64, "cpu", "mujoco", reset_noise=0.01)
    bank = bank_of(env, 4)
    env.adopt(bank)
    rows = torch.arange(64) % 4
    env.embody(rows, torch.ones(64, dtype=torch.bool))
    heights = env.physics.qpos[:, 2].numpy()
    for row, start in enumerate(bank.starts):
        own = heights[rows == row]
        assert np.ptp(own) > 0 and np.abs(own - start[2]).max() <= 0.01


@scaled(0.1)
@pytest.mark.parametrize("kind", ["dual", "single", "conditioned"])
def test_policies_of_another_body_are_those_of_its_condition(kind):
    algorithm = {"algorithm": "amor"} if kind == "conditioned" else {"network.type": kind}
    config = small(**algorithm)
    learner = learner_of(config)
    policy = morlax_torch.Policy(learner.agent, config, learner.env.objectives)
    seen = torch.randn(3, learner.env.observation_size)
    design = {"thigh": 0.45, "calf": 0.22}
    scaled = [2 * (0.45 - 0.2) / 0.3 - 1, 2 * (0.22 - 0.2) / 0.3 - 1]
    condition = torch.tensor([[0.7, 0.3, *scaled]])
    expected = learner.agent.actors(condition).act(seen[None])[0]
    for wrong in (None, "thigh", {"thigh": "x"}):
        with pytest.raises(MorlaxError, match=r"a design is numbers|must be a number, not 'x'"):
            policy.for_design(wrong)
    other = policy.for_design(design)
    torch.testing.assert_close(other(seen, [0.7, 0.3]), expected)
    torch.testing.assert_close(other.specialize([0.7, 0.3])(seen), expected)
    assert (policy(seen, [0.7, 0.3]) - expected).abs().max() > 1e-3
    assert other.config.task.design == design


def test_clusters_keep_a_body_for_an_episode_and_then_change():
    learner = learner_of(small(**{"task.episode_length": 20}))
    rows, ages = [], []
    for _ in range(12):
        learner.explore()
        assert learner.designs is not None
        rows.append(learner.designs.rows.clone())
        worlds = learner.env.embodied
        assert torch.equal(worlds, rows[-1].repeat_interleave(4))
        ages.append(learner.env.age.view(4, 4).clone())
    # four clusters change one after the other, each after 20 steps: every fourth rollout of 5
    changes = torch.stack(rows[1:]) != torch.stack(rows[:-1])
    for cluster in range(4):
        (times,) = changes[:, cluster].nonzero(as_tuple=True)
        assert len(times) > 0 and len(set((times % 4).tolist())) == 1
    assert torch.stack(ages).max() <= 20


def test_the_conditions_of_a_cluster_are_its_tradeoff_and_its_body():
    learner = learner_of(small())
    learner.explore()
    space = DesignSpace(learner.env.designs)
    for cluster, condition in enumerate(learner.conditions):
        geom = learner.designs.bank.models[int(learner.env.embodied[4 * cluster])].geom
        design = {"thigh": 2 * geom("thigh").size[1], "calf": 2 * geom("calf").size[1]}
        expected = space.scaled(space.vector(design))
        assert condition[2:].numpy() == pytest.approx(expected, abs=1e-5)
        assert torch.equal(condition[:2], learner.tradeoffs[cluster])
    assert learner.metrics()["bodies"] == 8


def test_a_family_without_designs_trains_as_the_usual_robot_bit_for_bit():
    changes = {name: value for name, value in SMALL.items() if "designs" not in name}
    states = []
    for task in ("hopper", "design/hopper"):
        same = {"sampling.designs": 0, "sampling.cells": False}
        config = morlax_torch.config_for(task, **changes, **same)
        learner = learner_of(config)
        for _ in range(3):
            learner.iterate()
        states.append(learner.agent.state_dict())
    assert_same(*map(dict, states))


def test_evaluations_of_many_bodies_are_those_of_each_alone():
    config = small(**{"task.design": {"calf": 0.25}})
    learner = learner_of(config, 1)
    agent = learner.agent
    together = make_evaluator(agent, config, bodies=3).evaluate().parts(3)
    alone = make_evaluator(agent, config).evaluate()
    np.testing.assert_allclose(together[0].returns, alone.returns, rtol=1e-4)
    assert np.array_equal(together[0].tradeoffs, alone.tradeoffs)
    policy = morlax_torch.Policy(agent, config, learner.env.objectives)
    space = DesignSpace(agent.designs)
    for front, design in zip(together[1:], held_out(learner.env, 3)[1:], strict=True):
        other = policy.for_design(space.named(design))
        alone = make_evaluator(other.agent, other.config).evaluate()
        np.testing.assert_allclose(front.returns, alone.returns, rtol=1e-3)
    assert np.ptp([front.returns.sum() for front in together]) > 0


def test_a_run_with_designs_is_loaded_and_saved(run, tmp_path):
    policy = morlax_torch.load(run)
    assert policy.agent.designs["thigh"] == DesignParameter(0.33, 0.2, 0.5)
    copy = tmp_path / "copy.pt"
    morlax_torch.save(policy.for_design({"thigh": 0.4}), copy)
    seen = torch.randn(2, policy.agent.observation_size)
    expected = policy.for_design({"thigh": 0.4})(seen, [0.5, 0.5])
    torch.testing.assert_close(morlax_torch.load(copy)(seen, [0.5, 0.5]), expected)


def test_every_body_starts_with_the_policies_of_a_run_with_one(tmp_path):
    one = train(small(**{"sampling.designs": 0}), output=tmp_path / "one")
    config = small(start_from=str(one.folder))
    many = Session.of(config, output=tmp_path / "many").learner.agent
    policy = morlax_torch.load(one.folder / "checkpoints/best.pt")
    seen = torch.randn(1, 4, policy.agent.observation_size)
    for context in ([-1.0, 1.0], [0.3, 0.2]):
        found = many.actors(torch.tensor([[0.2, 0.8, *context]])).act(seen)
        torch.testing.assert_close(found[0], policy(seen[0], [0.2, 0.8]))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"algorithm": "hyper-sac"}, "algorithm hyper-sac cannot train with many bodies"),
        ({"env": "hopper"}, "hopper declares no design parameters"),
    ],
)
def test_what_cannot_have_designs_says_so(changes, sentence):
    task = changes.pop("env", "design/hopper")
    with pytest.raises(MorlaxError, match=sentence):
        learner_of(small(task, **changes))


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    config = small(**{"task.episode_length": 60})
    with scaled():
        return train(config, output=tmp_path_factory.mktemp("designs") / "run").folder


def test_a_pair_is_simulated_as_its_body_alone_is_evaluated(run):
    policy = morlax_torch.load(run)
    designer = Designer(policy)
    designs = designer.space.spread(3, 0)
    tradeoffs = np.array([[0.9, 0.1], [0.2, 0.8], [0.5, 0.5]])
    found = designer.simulate(designs, tradeoffs)
    for design, tradeoff, returns in zip(designs, tradeoffs, found.returns, strict=True):
        other = policy.for_design(designer.space.named(design))
        env = other.config.make_worlds(1, 0, evaluating=True)
        points = torch.tensor(tradeoff[None], dtype=torch.float32)
        alone = Evaluator(other.agent, env, points).evaluate()
        assert returns == pytest.approx(alone.returns[0], rel=1e-3)


def test_refining_looks_where_the_front_is(run):
    designer = Designer(morlax_torch.load(run))
    grid = designer.grid(6, 4)
    assert grid.designs[:4].tolist() == [designer.space.default.tolist()] * 4
    refined = designer.refine(grid, rounds=3, population=12)
    assert len(refined.designs) == 36
    every = grid.joined(refined)
    assert designer.hypervolume(every) > designer.hypervolume(grid)
    for name, each in zip(designer.space.parameters, every.designs.T, strict=True):
        _, low, high, _ = designer.space.parameters[name]
        assert low <= each.min() and each.max() <= high
    assert every.tradeoffs.sum(1) == pytest.approx(1)
    best, volume = designer.best_body(grid, 4)
    volumes = [designer.hypervolume(grid.rows(np.arange(i, i + 4))) for i in range(0, 24, 4)]
    assert volume == max(volumes)
    assert best.tolist() == grid.designs[4 * int(np.argmax(volumes))].tolist()


def test_the_command_writes_the_body_that_serves_best(run, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(DesignedHopper, "titles", {"jump": "leaps"})
    draw, labels = figures.designs_figure, []
    monkeypatch.setattr(figures, "designs_figure", lambda *x: labels.extend(x[0]) or draw(*x))
    options = ["--bodies", "6", "--tradeoffs", "4", "--rounds", "1", "--population", "8"]
    words = [str(run), *options, "--output", str(tmp_path / "found"), "--device", "cpu"]
    searching.command([*words, "--maximize", "jump", "--at-least", "run=1"])
    text = capsys.readouterr().out
    assert "32 policies were simulated" in text and "most jump: " in text
    assert labels == ["run", "leaps"]
    best = max(csv_rows(tmp_path / "found" / "designs.csv"), key=lambda row: float(row["jump"]))
    policy = morlax_torch.load(tmp_path / "found" / "body.pt")
    own = policy.config.task.design
    assert own["thigh"] == pytest.approx(float(best["thigh"]), rel=1e-5)
    assert set(searching.FILES) == {file.name for file in (tmp_path / "found").iterdir()}
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "found" / "body.xml"))
    exact = envs.make_robot("design/hopper", design=own).physics.model
    for name in ("geom_size", "geom_pos", "body_pos", "body_mass", "jnt_range"):
        np.testing.assert_allclose(getattr(model, name), getattr(exact, name), atol=1e-5)
    searching.command(words)
    assert "body with the largest hypervolume: thigh" in capsys.readouterr().out
    words[words.index("--output") + 1] = str(tmp_path / "other")
    with pytest.raises(MorlaxError, match="no simulated policy keeps every requirement"):
        searching.command([*words, "--maximize", "jump", "--at-least", "run=1e6"])
    text = capsys.readouterr().out
    assert "most run: run " in text  # which would be possible
    assert "body with the largest hypervolume: thigh" in text and "written: " in text
    assert set(searching.FILES) == {file.name for file in (tmp_path / "other").iterdir()}


def test_a_wrong_search_is_one_sentence_before_it_begins(run, refused, monkeypatch):
    monkeypatch.setattr(Designer, "simulate", None)
    assert "did you mean 'jump'" in refused(searching, str(run), "--maximize", "jmp")
    assert "name what to maximize" in refused(searching, str(run), "--at-least", "run=1")
    assert "were trained with one body" in refused(searching, "hopper")


def test_a_robot_of_ones_own_declares_designs_in_ten_lines(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "designs.md").read_text()
    (block,) = re.findall(r"```python\n(# long_legs\.py.*?)```", page, re.S)
    (tmp_path / "long_legs.py").write_text(block)
    name = f"{tmp_path / 'long_legs.py'}:LongLegs"
    envs.trust(name)
    feet = []
    for length in (0.3, 0.45, 0.6):
        env = envs.make_robot(name, design={"thigh": length})
        assert env.physics.model.geom("left_thigh").size[1] == pytest.approx(length / 2)
        data = mujoco.MjData(env.physics.model)
        data.qpos[:] = env.initial_qpos()
        mujoco.mj_forward(env.physics.model, data)
        feet.append(data.geom("left_foot").xpos[2])
    assert feet == pytest.approx([feet[0]] * 3)
    train(small(name), output=tmp_path / "run")
    assert len(morlax_torch.load(tmp_path / "run").agent.context) == 1


@pytest.mark.slow
def test_a_family_is_compared_with_specialists(run, tmp_path):
    comparing.main(str(run), bodies=2, seconds=0.5, device="cpu", output=tmp_path / "rows.csv")
    policy = morlax_torch.load(run)
    for row in csv_rows(tmp_path / "rows.csv"):
        design = {"thigh": float(row["thigh"]), "calf": float(row["calf"])}
        own = morlax_torch.evaluate(policy.for_design(design), device="cpu")
        assert float(row["family"]) == pytest.approx(own.hypervolume)
        assert float(row["specialist"]) > 0


def test_a_film_shows_bodies_side_by_side(run, tmp_path, opengl):
    words = [str(run), "--width", "64", "--height", "64", "--seconds", "0.1"]
    bodies = ["--body", "thigh=0.2,calf=0.2", "--body", "thigh=0.5"]
    record.command([*words, *bodies, "--pictures", "2", "--output", str(tmp_path / "s.png")])
    strip = plt.imread(tmp_path / "s.png")
    film = Film(morlax_torch.load(run), [(0.5, 0.5)], 64, 64, bodies=[{"thigh": 0.2}, {}])
    frame = next(film.frames(0.1))
    assert frame.shape[1] > 2 * 64  # two panels
    left, right = frame[:, :64], frame[:, -64:]
    assert not np.array_equal(left, right)
    assert [take.label().split("\n")[0] for take in film._takes] == ["thigh 0.2 m", "run 0.50"]
    assert strip.shape[0] > 2 * 64


def test_a_body_that_is_no_list_of_numbers_is_one_sentence(run, refused):
    for text in ("thigh", "thigh=long"):
        assert f"'{text}' names no number" in refused(record, str(run), "--body", text)
    assert "were trained with one body" in refused(record, "hopper", "--body", "thigh=0.4")


def test_a_slider_changes_the_body_and_then_the_front(run, monkeypatch):
    monkeypatch.setattr("morlax_torch.runs.choosing.MOST_BATCHES", 1)
    waiting = Queue[Any]()
    exhibit = RunExhibit(choose(str(run), None), waiting.put)
    session = exhibit.robots[0]
    opened, model = session.opened, session.model
    assert exhibit.state()["design"] == [0.33, 0.32] and exhibit.state()["measured"]
    exhibit.react({"act": "reshape", "index": 1, "value": 9.0})  # clamped
    design = {"thigh": 0.33, "calf": 0.5}
    assert session.model is not model and session.opened is opened  # the panel stays
    assert session.model.geom("calf").size[1] == pytest.approx(0.25)
    assert exhibit.state()["design"] == [0.33, 0.5] and not exhibit.state()["measured"]
    assert exhibit.state()["choosing"] is None and session.front is None
    exhibit.react({"act": "press", "name": "add"})
    assert len({id(each.policy) for each in exhibit.robots}) == 1
    with pytest.raises(MorlaxError, match="no front yet: that of this body comes soon"):
        exhibit.react({"act": "press", "name": "find"})
    exhibit.react({"act": "press", "name": "measure"})
    while not exhibit.state()["measured"]:
        waiting.get(timeout=PATIENCE)()
    policy = morlax_torch.load(run).for_design(design)
    expected = evaluate(policy, 33, device="cpu").returns
    for session in exhibit.robots:
        assert session.front.returns == pytest.approx(expected)
    state = exhibit.state()
    assert state["front"]["checkpoint"] == "this body" and state["choosing"] is not None
    exhibit.react({"act": "require", "index": 0, "level": -1e9})
    exhibit.react({"act": "select", "robot": 0})
    while (state := exhibit.state())["choosing"]["searching"]:
        waiting.get(timeout=PATIENCE)()
    assert list(state["choosing"]["levels"]) == ["0"]  # also of another robot with this body

    cards = []
    monkeypatch.setattr(page, "card", lambda *told: cards.append(told) or "")
    exhibit.react({"act": "press", "name": "card"})
    while exhibit.state()["saving"]["busy"]:
        waiting.get(timeout=PATIENCE)()
    ((named, shown, _, commands, _),) = cards
    assert morlax_torch.load(named).config.task.design == shown.config.task.design == design
    assert named in commands[0]
    exhibit.react({"act": "reshape", "index": 0, "value": 0.4})
    assert exhibit.state()["choosing"] is None


def test_a_front_of_a_former_body_is_not_shown(run):
    waiting = Queue[Any]()
    exhibit = RunExhibit(choose(str(run), None), waiting.put)
    for value in (0.4, 0.45):
        exhibit.react({"act": "reshape", "index": 0, "value": value})
        if value == 0.4:
            exhibit.react({"act": "press", "name": "measure"})
    waiting.get(timeout=PATIENCE)()
    assert exhibit.robots[0].front is None and not exhibit.state()["measured"]


def test_robots_with_one_body_have_no_sliders_for_it():
    exhibit = RunExhibit(choose("hopper", None), lambda request: None)
    model = exhibit.robots[0].model
    exhibit.react({"act": "reshape", "index": 0, "value": 0.4})
    assert exhibit.robots[0].model is model and exhibit.state()["design"] == []


@pytest.mark.slow
def test_a_body_is_changed_in_a_browser(run, workplace):
    with chromium() as browser, exploring(str(run)) as (address, _):
        view = View(browser, address)
        view.drag("thigh (m)", 1.0)
        view.until(lambda: view.value("thigh (m)") == 0.5, "the slider does not stay")
        view.moves()
        front = view.tab.locator("#front-section")
        view.until(lambda: "stale" not in (front.get_attribute("class") or ""), "no front comes")
        assert view.value("thigh (m)") == pytest.approx(0.5)
        assert view.errors == []
