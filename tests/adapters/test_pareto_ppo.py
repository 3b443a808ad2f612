"""rsl_rl's own runner and update train a family of policies, in any host with reward terms."""

import contextlib
import io
import math
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import morlax_torch
from morlax_torch import MorlaxError

pytest.importorskip("rsl_rl", reason="rsl_rl is not installed")

import points
from points import OBJECTIVES, Points
from programs import ended, start_both
from rsl_rl.modules.distribution import GaussianDistribution
from rsl_rl.runners import OnPolicyRunner

from morlax_torch.adapters.pareto_ppo import FamilyStorage
from morlax_torch.adapters.reward_terms import ObjectiveRewards, terms_of
from morlax_torch.rsl_rl import specialize

pytestmark = pytest.mark.usefixtures("single_thread")
TASK = f"{Path(points.__file__)}:PointsTask"
PARETO = "morlax_torch.rsl_rl:ParetoPPO"


def settings(kind: str = PARETO, **algorithm: Any) -> dict[str, Any]:
    network = {"class_name": "MLPModel", "hidden_dims": [32, 32], "activation": "elu"}
    network["obs_normalization"] = True
    spread = {"class_name": "GaussianDistribution", "init_std": 0.5, "std_type": "scalar"}
    options = {"objectives": OBJECTIVES, "tradeoffs": 8, "evaluation_worlds": 32, "warmup": 10}
    algorithm = (options if kind == PARETO else {}) | algorithm
    return {
        "seed": 1,
        "num_steps_per_env": 8,
        "save_interval": 1000,
        "logger": "tensorboard",
        "obs_groups": {"actor": ["actor"], "critic": ["critic"]},
        "actor": {**network, "distribution_cfg": spread},
        "critic": dict(network),
        "algorithm": {"class_name": kind, "gamma": 0.9, "entropy_coef": 0.0, **algorithm},
    }


def make(env: Any = None, kind: str = PARETO, folder: Any = None, **algorithm: Any) -> Any:
    with contextlib.redirect_stdout(io.StringIO()):
        return OnPolicyRunner(env or Points(), settings(kind, **algorithm), folder, "cpu")


def learn(runner: Any, iterations: int, **options: Any) -> Any:
    with contextlib.redirect_stdout(io.StringIO()):
        runner.learn(iterations, **options)
    return runner


def anywhere() -> Any:
    """Return what points at random places observe."""
    obs = Points().get_observations()
    obs["actor"].normal_()
    return obs


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> tuple[Any, Path]:
    """A runner after 60 iterations, and the folder of its checkpoints."""
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("rsl_rl")
    runner = make(folder=str(folder), task=TASK)
    return learn(runner, 60, init_at_random_ep_len=True), folder


def test_its_front_trades_off_and_tensorboard_shows_it(trained):
    runner, folder = trained
    returns = runner.alg.front.returns()  # from saving alone to tracking alone
    assert returns[-1, 0] > returns[0, 0] + 1 and returns[0, 1] > returns[-1, 1] + 0.2
    logged = EventAccumulator(str(folder)).Reload()
    volumes = [event.value for event in logged.Scalars("Pareto/hypervolume")]
    assert volumes[-1] > 0 and len(logged.Scalars("Pareto/mean_reward/tracking")) >= 59
    assert logged.Scalars("Pareto/non_dominated")[-1].value >= 0.5


def test_what_a_host_logs_when_episodes_end_comes_first():
    env, steps = Points(), []
    step = env.step

    def log_at_ends(actions: torch.Tensor) -> tuple[Any, ...]:
        *others, extras = step(actions)
        if not extras["time_outs"].any():
            del extras["log"]
        steps.append(extras)
        return *others, extras

    env.step = log_at_ends
    learn(make(env), 3)
    logs = {index: extras["log"] for index, extras in enumerate(steps) if "log" in extras}
    assert [*logs] == [7, 15, 19, 23]  # of rollouts of 8 steps and episodes of 20
    assert all("Pareto/mean_reward/tracking" in log for log in logs.values())


def test_an_objective_may_be_named_like_an_indicator():
    objectives = {"hypervolume": OBJECTIVES["tracking"], "saving": OBJECTIVES["saving"]}
    logged = learn(make(objectives=objectives), 6).alg._logged
    assert {"Pareto/hypervolume", "Pareto/mean_reward/hypervolume"} <= logged.keys()


def test_advantages_are_those_of_ppo_for_the_weighted_reward():
    torch.manual_seed(1)
    family = make(tradeoffs=1, evaluation_worlds=0, focus=(3.0, 1.0)).alg
    plain = make(kind="PPO", normalize_advantage_per_mini_batch=True).alg
    obs = family.storage.observations[0]
    with torch.inference_mode():
        family._begin_rollout()
        weights = family.actor.tradeoffs[0]
        for storage in (family.storage, plain.storage):
            storage.dones.random_(0, 2)
        plain.storage.dones.copy_(family.storage.dones)
        rewards, values = torch.randn(2, *family.storage.rewards.shape)
        family.storage.rewards.copy_(rewards)
        family.storage.values.copy_(values)
        plain.storage.rewards.copy_((rewards @ weights)[..., None])
        plain.storage.values.copy_((values @ weights)[..., None])
        plain.critic.load_state_dict(family.critic.plain(weights).state_dict())
        family.compute_returns(obs)
        plain.compute_returns(obs)
    expected = plain.storage.advantages
    expected = (expected - expected.mean()) / (expected.std() + 1e-8)
    assert torch.allclose(family.storage.advantages, expected, atol=1e-5)


def test_fewer_tradeoffs_than_objectives_take_turns():
    family, drawn = make(tradeoffs=1, evaluation_worlds=0, warmup=0).alg, []
    for _ in range(40):
        family._begin_rollout()
        drawn.append(family.actor.tradeoffs)
    assert torch.cat(drawn).argmax(1).float().mean().item() == pytest.approx(0.5, abs=0.4)


def test_rows_of_minibatches_stay_with_their_tradeoffs():
    storage = FamilyStorage(2, 8, "rl", 16, 6, Points(16).get_observations(), [2], "cpu")
    storage.actions[:] = torch.arange(16.0)[:, None]
    storage.actions_log_prob[:] = torch.arange(96.0).view(6, 16, 1)
    storage.distribution_params = (storage.actions,)
    batches = [*storage.mini_batch_generator(3, 2)]
    assert len(batches) == 6
    for batch in batches:
        assert torch.equal(batch.actions[:, 0] % 8, torch.arange(32) % 8)
    rows = torch.cat([batch.old_actions_log_prob[:, 0] for batch in batches[:3]])
    assert torch.equal(rows.sort().values, torch.arange(96.0))  # each once
    assert not torch.equal(rows, torch.arange(96.0))


def test_a_specialized_checkpoint_is_that_of_unmodified_ppo(trained, tmp_path):
    runner, folder = trained
    tradeoff, file = torch.tensor([0.8, 0.2]), tmp_path / "model_7.pt"
    specialize(folder / "model_59.pt", (4, 1), file)
    plain = make(kind="PPO", folder=str(tmp_path))
    plain.load(str(file))
    obs = anywhere()
    with torch.no_grad():
        runner.alg.eval_mode()
        actions, values = (
            x.run(obs, tradeoff[None]) for x in (runner.alg.actor, runner.alg.critic)
        )
        assert torch.allclose(plain.get_inference_policy()(obs), actions[:, 0], atol=1e-6)
        assert torch.allclose(plain.alg.critic(obs)[:, 0], values @ tradeoff, atol=1e-5)
    plain.alg.train_mode()
    learn(plain, 2)  # with its own update
    assert (tmp_path / f"model_{plain.current_learning_iteration}.pt").is_file()


@pytest.mark.skipif(
    "learn_std" not in signature(GaussianDistribution).parameters, reason="rsl_rl before 5.2"
)
def test_a_specialized_checkpoint_keeps_fixed_standard_deviations(tmp_path):
    cfg = {kind: settings(kind) for kind in (PARETO, "PPO")}
    for each in cfg.values():
        each["actor"]["distribution_cfg"] |= {"learn_std": False, "init_std": 0.3}
    learn(OnPolicyRunner(Points(), cfg[PARETO], str(tmp_path), "cpu"), 1)
    specialize(tmp_path / "model_0.pt", (1, 1), tmp_path / "model_7.pt")
    plain = OnPolicyRunner(Points(), cfg["PPO"], None, "cpu")
    plain.load(str(tmp_path / "model_7.pt"))
    learn(plain, 1)
    assert plain.alg.actor.output_std.unique().tolist() == pytest.approx([0.3])


def test_a_warmup_learns_the_focus_alone():
    torch.manual_seed(2)
    runner, obs = make(focus=(3.0, 1.0), warmup=3), anywhere()
    tradeoffs, actor = torch.eye(2), runner.alg.actor

    def outputs() -> torch.Tensor:
        with torch.no_grad():
            return actor.run(obs[:1].expand(2), tradeoffs)[:, 0]

    before, _ = outputs()
    runner = learn(runner, 3)
    assert torch.equal(*outputs()) and not torch.equal(outputs()[0], before)
    assert actor.tradeoffs.tolist() == [[0.75, 0.25]]
    learn(runner, 3)
    one, other = outputs()
    assert len(actor.tradeoffs) == 8 and not torch.equal(one, other)


def test_an_unmodified_play_script_shows_the_focus(trained):
    runner, folder = trained
    plain = make(kind="PPO")
    plain.load(str(folder / "model_59.pt"), {"actor": True})
    runner.alg.eval_mode()
    obs = Points().get_observations()
    with torch.no_grad():
        expected = runner.alg.actor.run(obs, torch.tensor([[0.5, 0.5]]))[:, 0]
        assert torch.allclose(plain.get_inference_policy()(obs), expected, atol=1e-6)


def test_a_play_script_shows_the_tradeoffs_that_the_environment_names(trained, monkeypatch):
    _, folder = trained
    monkeypatch.setenv("MORLAX_TRADEOFF", "all")
    runner = make(Points(5))
    runner.load(str(folder / "model_59.pt"), {"actor": True})
    policy, env = runner.get_inference_policy(), runner.env
    with torch.no_grad():
        for _ in range(3):
            env.step(policy(env.get_observations()))
    assert env.position[0].sum() < env.position[2].sum() < env.position[4].sum()
    with pytest.raises(MorlaxError, match="one trade-off per world, and needs at least 2"):
        make(Points(1))


def test_training_resumes_and_starts_from_a_plain_checkpoint(trained, tmp_path):
    runner, folder = trained
    again, parts = make(), ("actor", "critic", "optimizer", "iteration")
    again.load(str(folder / "model_59.pt"), dict.fromkeys(parts, True))
    assert again.current_learning_iteration == 59 and again.alg._rollouts == 60  # warmed up
    again.load(str(folder / "model_59.pt"))
    state, expected = again.alg.actor.state_dict(), runner.alg.actor.state_dict()
    assert all(torch.equal(state[name], expected[name]) for name in expected)
    squares, expected = (alg.optimizer.state_dict()["state"] for alg in (again.alg, runner.alg))
    for index, row in expected.items():  # one learning rate per parameter, nearly
        ratio = (squares[index]["exp_avg_sq"] + 1e-16).sqrt() / (row["exp_avg_sq"] + 1e-16).sqrt()
        assert 0.7 < ratio.median() < 1.4 and (ratio.log().abs() < 1).float().mean() > 0.8
    before = again.alg.front.returns()
    learn(again, 3, init_at_random_ep_len=True)
    assert torch.allclose(again.alg.front.returns(), before, atol=0.4)  # of whole episodes only

    plain = learn(make(kind="PPO", folder=str(tmp_path)), 2)
    family = make()
    family.load(str(tmp_path / "model_1.pt"))
    assert family.alg.learning_rate == 1e-5  # else its first update would undo what was learned
    for policy in (plain, family):
        policy.alg.eval_mode()
    obs = Points().get_observations()
    with torch.no_grad():
        actions, values = plain.alg.actor(obs), plain.alg.critic(obs)
        assert torch.allclose(family.alg.actor(obs), actions, atol=1e-6)
        assert torch.allclose(family.alg.critic(obs), values.expand(-1, 2), atol=1e-5)
    family.alg.train_mode()
    learn(family, 1)  # its policy has warmed up
    assert len(family.alg.actor.tradeoffs) == 8


def test_a_checkpoint_is_a_run(trained):
    runner, folder = trained
    policy = morlax_torch.load(folder, trust=True)  # the newest checkpoint
    assert policy.objectives == ("tracking", "saving")
    obs = anywhere()
    runner.alg.eval_mode()
    for tradeoff in ((1.0, 0.0), (0.3, 0.7)):
        with torch.no_grad():
            expected = runner.alg.actor.run(obs, torch.tensor([tradeoff]))[:, 0]
        actions = 10 * policy(obs["actor"], tradeoff)
        assert torch.allclose(actions, expected, atol=1e-5)
    assert policy.reward_weights((1.0, 0.0))["track_x"] == 1.0


def test_a_checkpoint_of_linear_layers_as_wide_as_the_input_is_a_run(tmp_path):
    cfg = settings(task=TASK, tradeoffs=1) | {"seed": -1}  # at random
    cfg["actor"] |= {"hidden_dims": [-1, 8], "activation": "identity"}
    with contextlib.redirect_stdout(io.StringIO()):
        runner = learn(OnPolicyRunner(Points(), cfg, None, "cpu"), 1)
    runner.save(str(tmp_path / "model.pt"))
    policy, obs = morlax_torch.load(tmp_path / "model.pt", trust=True), anywhere()
    runner.alg.eval_mode()
    with torch.no_grad():
        assert torch.allclose(10 * policy(obs["actor"], (1, 1)), runner.alg.actor(obs), atol=1e-5)


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
def test_rsl_rl_exports_one_tradeoff(trained, tmp_path):
    runner, _ = trained
    runner.export_policy_to_jit(str(tmp_path))
    runner.alg.eval_mode()
    observation = torch.randn(3, 2)
    with torch.no_grad():
        actions = torch.jit.load(tmp_path / "policy.pt")(observation)
        obs = Points(3).get_observations()
        obs["actor"] = observation
        assert torch.allclose(actions, runner.alg.actor(obs), atol=1e-6)


def test_mirrored_data_keep_their_tradeoffs():
    def mirrored(env: Any, obs: Any, actions: Any) -> Any:
        return (
            None if obs is None else torch.cat([obs, obs]),
            None if actions is None else torch.cat([actions, actions.flip(1)]),
        )

    symmetry = {"data_augmentation_func": mirrored, "use_data_augmentation": True}
    runner = make(symmetry_cfg={**symmetry, "use_mirror_loss": True, "mirror_loss_coeff": 0.1})
    actor = learn(runner, 20).alg.actor
    obs, _ = mirrored(None, Points(64).get_observations(), None)
    with torch.no_grad():
        rows, images = actor(obs).chunk(2)  # of points at the same place
    assert torch.equal(rows, images)
    assert torch.equal(rows[:8], rows[8:16]) and len(rows[:8].unique(dim=0)) == 8


@pytest.mark.parametrize("listed", [False, True], ids=["Genesis", "legged_gym"])
def test_reward_functions_of_other_hosts_are_terms(listed):
    env = SimpleNamespace(reward_scales={"height": 0.02, "energy": -0.1})
    functions = {"height": lambda: torch.tensor([1.0, 2.0]), "energy": lambda: torch.ones(2)}
    env.reward_functions = [*functions.values()] if listed else dict(functions)
    env.reward_names = [*functions]
    rewards = ObjectiveRewards(terms_of(env))

    def reward_of_step() -> Any:
        called = env.reward_functions if listed else env.reward_functions.values()
        return sum(f() * s for f, s in zip(called, env.reward_scales.values(), strict=True))

    parts, guide = rewards(reward := reward_of_step())
    assert torch.allclose(parts, torch.tensor([[0.02, -0.1], [0.04, -0.1]]))
    assert torch.allclose(guide[:, 0], reward)  # the whole reward leads every trade-off
    env.reward_functions = [*functions.values()] if listed else functions  # as a host may, later
    with pytest.raises(MorlaxError, match="another reward function 'height'"):
        rewards(reward_of_step())


def host_of_functions() -> Any:
    """Return worlds of Genesis with a term that they do not pay, and how they reward a step."""
    functions = {name: lambda: torch.ones(2) for name in ("height", "energy", "late")}
    scales = {"height": 0.02, "energy": -0.1, "late": 0.0}
    return SimpleNamespace(reward_functions=functions, reward_scales=scales)


def paid_by(env: Any) -> Any:
    return sum(f() * env.reward_scales[name] for name, f in env.reward_functions.items())


def test_scales_that_a_host_replaces_count():  # a curriculum
    env = host_of_functions()
    rewards = ObjectiveRewards(terms_of(env))
    env.reward_scales = {name: 3 * scale for name, scale in env.reward_scales.items()}
    parts, guide = rewards(reward := paid_by(env))
    assert torch.allclose(parts, torch.tensor([0.06, -0.3]))
    assert torch.allclose(guide[:, 0], reward)


@pytest.mark.parametrize("added", ["late", "termination", "new"])
def test_terms_that_a_host_pays_later_are_one_sentence(added):
    env = host_of_functions()
    rewards = ObjectiveRewards(terms_of(env))
    if added == "new":
        env.reward_functions["new"] = lambda: torch.ones(2)
    env.reward_scales[added] = 1.0
    with pytest.raises(MorlaxError, match=f"term {added} had no weight when training began"):
        rewards(paid_by(env))


def test_a_script_that_plays_may_switch_rewards_off(trained):  # as Genesis' go2_eval.py does
    _, folder = trained
    env = Points(1)
    del env.reward_manager
    runner = make(env, objectives=None)
    with pytest.raises(MorlaxError, match="'saving'\\], not \\['rewards', 'costs'\\]"):
        runner.load(str(folder / "model_59.pt"))
    learn(make(Points(), objectives=None, folder=str(folder / "own")), 1)
    runner.load(str(folder / "own" / "model_0.pt"))
    assert runner.get_inference_policy()(env.get_observations()).shape == (1, 2)


def test_the_termination_reward_of_legged_gym_is_a_term():
    env = SimpleNamespace(reward_scales={"height": 0.02, "energy": -0.1, "termination": -5.0})
    env.reward_names, env.reward_functions = ["height", "energy"], 2 * [lambda: torch.ones(2)]
    env._reward_termination = lambda: torch.tensor([0.0, 1.0])
    rewards = ObjectiveRewards(terms_of(env))
    for function in (*env.reward_functions, env._reward_termination):
        function()
    parts, guide = rewards(torch.tensor([-0.08, -5.08]))
    assert torch.allclose(parts[:, 1], torch.tensor([-0.1, -5.1]))
    assert torch.allclose(guide[:, 0], torch.tensor([-0.08, -5.08]))


def test_a_term_that_the_host_does_not_pay_has_a_weight_of_one():
    env = Points(2)
    for _ in range(2):  # the second time in worlds that are watched already
        rewards = ObjectiveRewards(terms_of(env), OBJECTIVES, {"*": 1.0, "effort": 0.0})
        _, reward, _, _ = env.step(torch.ones(2, 2))
        parts, guide = rewards(reward)
        env.reset()
        assert parts[0].tolist() == pytest.approx([0.04, 0.1 * (-0.5 * 2 + 0.05)], rel=1e-4)
        assert guide[0, 0].item() == pytest.approx(0.04)
    env.reward_manager._terms["alive"] = SimpleNamespace(weight=0.1, func=lambda: torch.ones(2))
    with pytest.raises(MorlaxError, match="term alive had no weight"):  # a curriculum's
        rewards(env.step(torch.ones(2, 2))[1])


def function_of_terms(env: Points) -> dict[str, torch.Tensor]:
    return {"x": env.position[:, :1], "y": -env.position[:, 1], **getattr(env, "more", {})}


def test_a_function_reads_the_terms_of_any_other_host():
    alg = learn(make(terms=f"{__name__}:function_of_terms", objectives=None), 1).alg
    assert alg.objectives == ["x", "y"]
    env = Points(2)
    env.position = torch.tensor([[1, 2], [3, 4]])  # counts
    terms = terms_of(env, f"{__name__}:function_of_terms")
    rewards = ObjectiveRewards(terms, {"x": {"x": 0.5}, "y": {"y": 1.0}})
    parts, _ = rewards(torch.zeros(2))
    assert parts.tolist() == [[0.5, -2.0], [1.5, -4.0]]
    env.more = {"z": torch.ones(2)}
    with pytest.raises(MorlaxError, match="term z had no weight when training began"):
        rewards(torch.zeros(2))
    env.position = torch.ones(8, 2)  # a term for each of four feet
    with pytest.raises(MorlaxError, match="function_of_terms cannot be read: Runtime"):
        terms.read()
    with pytest.raises(MorlaxError, match=f"MODULE:FUNCTION, such as mine:terms, not '{__name__}'"):
        terms_of(env, __name__)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tradeoffs": 70}, "96 worlds are fewer than tradeoffs \\(70\\)"),
        ({"tradeoffs": 6}, "tradeoffs \\(6\\) must divide .* set tradeoffs to 4"),
        ({"num_mini_batches": 7}, "the 7 minibatches: change the number of worlds, eval"),
        ({"evaluation_worlds": 12}, "must be a multiple of 8"),
        ({"objectives": {"a": {"trak_x": 1.0}, "b": {"effort": 1.0}}}, "did you mean 'track_x'"),
        ({"objectives": {"a": {"effort": 1.0}}}, "at least two objectives"),
        ({"objectives": {}}, "at least two objectives"),
        ({"rnd_cfg": {"weight": 1.0}}, "remove rnd_cfg"),
        ({"optimizer": "rmsprop"}, "set optimizer to adam"),
        ({"tradeofs": 8}, "option of ParetoPPO 'tradeofs': did you mean 'tradeoffs'"),
        ({"device": "cpu"}, r"option of ParetoPPO 'device'.* Known: (?!.*\b(actor|storage)\b)"),
        ({"focus": (1.0, 0.0, 0.0)}, "focus needs 2 numbers \\(tracking, saving\\), not 3"),
        ({"guide": {"alive": math.nan}}, "guide.alive: Input should be a finite number"),
        ({"reference_point": (-9.0,)}, "reference_point needs 2 numbers .*, not 1"),
        ({"task": "hopper"}, "in hopper, which has no action_scale: leave out the option task"),
    ],
)
def test_wrong_options_are_one_sentence(options, message):
    with pytest.raises(MorlaxError, match=message):
        learn(make(**options), 1)


def test_a_family_of_other_features_is_one_sentence(trained, tmp_path):
    with pytest.raises(MorlaxError, match="other objectives, features, layers"):
        make(features=5).load(str(trained[1] / "model_59.pt"))
    with pytest.raises(MorlaxError, match=r"'saving'\], not \['saving', 'tracking'\]"):
        make(objectives=dict(reversed(OBJECTIVES.items()))).load(str(trained[1] / "model_59.pt"))
    descending = make(optimizer="sgd")
    with pytest.raises(MorlaxError, match="its optimizer is adam, not sgd"):
        descending.load(str(trained[1] / "model_59.pt"))
    descending.load(str(trained[1] / "model_59.pt"), {"actor": True})  # to play
    cfg = settings()
    cfg["actor"]["distribution_cfg"]["std_type"] = "log"  # with as many parameters
    with pytest.raises(MorlaxError, match="std_param, not log_std_param"):
        OnPolicyRunner(Points(), cfg, None, "cpu").load(str(trained[1] / "model_59.pt"))
    learn(make(kind="PPO", folder=str(tmp_path)), 1)
    cfg = settings()
    cfg["critic"]["hidden_dims"] = [32]
    with pytest.raises(MorlaxError, match="plain checkpoint has other layers"):
        OnPolicyRunner(Points(), cfg, None, "cpu").load(str(tmp_path / "model_0.pt"))
    with pytest.raises(MorlaxError, match="is a checkpoint of rsl_rl that is no run"):
        morlax_torch.load(tmp_path)
    with pytest.raises(MorlaxError, match="no checkpoint that ParetoPPO has written"):
        specialize(Path(__file__), (1, 1), "never.pt")
    loaded = torch.load(trained[1] / "model_59.pt", weights_only=True)
    for family in ([], loaded["family"] | {"shapes": 3}, loaded["family"] | {"critic": {}}):
        torch.save(loaded | {"family": family}, tmp_path / "damaged.pt")
        with pytest.raises(MorlaxError, match=r"damaged\.pt is no checkpoint that ParetoPPO"):
            specialize(tmp_path / "damaged.pt", (1, 1), "never.pt")


def test_other_models_and_rewards_are_one_sentence():
    cfg = settings()
    cfg["actor"] |= {"class_name": "RNNModel"}
    with pytest.raises(MorlaxError, match="the actor is a RNNModel"):
        OnPolicyRunner(Points(), cfg, None, "cpu")
    with pytest.raises(MorlaxError, match="name a function"):
        terms_of(SimpleNamespace())
    env = Points()
    rewards = ObjectiveRewards(terms_of(env), OBJECTIVES)
    rewards(env.step(torch.zeros(96, 2))[1].clamp(min=0))  # there is nothing to clip
    for name in {*env.reward_manager.active_terms} - {"alive"}:
        env.reward_manager.get_term_cfg(name).weight *= 1e-3  # small rewards are checked as well
    _, reward, _, _ = env.step(torch.ones(96, 2))
    with pytest.raises(MorlaxError, match="add up to another reward"):
        rewards(reward.clamp(min=0))


def test_a_file_holds_the_options_where_the_host_takes_none(monkeypatch, tmp_path):
    file = tmp_path / "pareto.yaml"
    file.write_text("objectives: {near: {track_x: 1.0}, far: {track_y: 1.0}}\ntradeoffs: 4\n")
    monkeypatch.setenv("MORLAX_PARETO", str(file))
    runner = make()
    assert runner.alg.objectives == ["near", "far"] and runner.alg.storage.tradeoffs == 4


def test_an_empty_guide_leads_to_nothing_in_a_section_as_in_a_file(monkeypatch, tmp_path):
    def guide(**options: Any) -> dict[str, float]:
        runner = learn(make(**options), 1)
        return runner.alg._rewards.guide

    only = {"objectives": {"x": {"track_x": 1.0}, "y": {"track_y": 1.0}}}
    assert guide(**only) == {"effort": 1.0}  # the term that no objective has
    assert guide(**only, guide={}) == {}
    (tmp_path / "pareto.yaml").write_text("guide: {}")
    monkeypatch.setenv("MORLAX_PARETO", str(tmp_path / "pareto.yaml"))
    assert guide(**only) == {}


@pytest.mark.slow
def test_two_processes_stay_equal_and_draw_different_tradeoffs(tmp_path):
    code = "import sys, pareto_processes; pareto_processes.main(sys.argv[1])"
    statuses, _, errors = ended(start_both(code, tmp_path, [str(tmp_path / "of")]))
    assert statuses == [0, 0], errors
    (one, drawn), (other, others) = (torch.load(tmp_path / f"of{rank}.pt") for rank in (0, 1))
    assert torch.equal(one, other)
    assert not torch.equal(drawn, others)
