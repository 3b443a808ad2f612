"""Tasks of MuJoCo Playground: their rewards, restarts and last observations, and runs in them."""

import pytest
import torch
from peers import check_blown_up, check_run, noise
from tiny import tiny

from morlax_torch import MorlaxError, envs
from morlax_torch.commands.terminal.arguments import read

playground = pytest.importorskip("mujoco_playground", reason="needs the extra playground")
jax = pytest.importorskip("jax")
config_dict = pytest.importorskip("ml_collections.config_dict")

CARTPOLE = "playground:CartpoleBalance"
DRIFT = "playground:Drift"


class Drift(playground.MjxEnv):
    """Points on a line that fail beyond -1; the reward is the clipped sum of scaled terms."""

    action_size = 1
    xml_path = mj_model = mjx_model = None

    def reset(self, rng):
        x, zero = jax.random.uniform(rng), jax.numpy.zeros(())
        metrics = {f"reward/{name}": 0.0 for name in self._config.scales} | {"speed": 0.0}
        return playground.State(x, self._see(x, 0), zero, zero, metrics, {"steps": 0})

    def step(self, state, action):
        x, steps = state.data + action[0], state.info["steps"] + 1
        terms = {"go": action[0], "save": abs(action[0])}
        scaled = {name: scale * terms[name] for name, scale in self._config.scales.items()}
        metrics = {f"reward/{name}": value for name, value in scaled.items()} | {"speed": 0.0}
        reward = (0.1 * sum(scaled.values())).clip(0, 1)
        done = (x < -1).astype(float)
        return playground.State(x, self._see(x, steps), reward, done, metrics, {"steps": steps})

    def _see(self, x, steps):
        if self._config.shows == "image":
            return {"pixels/view_0": x * jax.numpy.ones((8, 8, 3))}
        state = jax.numpy.stack([x, jax.numpy.asarray(steps, float)])
        return {"state": state, "privileged_state": x[None] ** 2}


def drift_config():
    scales = {"go": 2.0, "save": -0.5}
    return config_dict.create(
        ctrl_dt=0.1, sim_dt=0.1, episode_length=6, scales=scales, shows="vectors"
    )


playground.dm_control_suite.register_environment("Drift", Drift, drift_config)


@pytest.fixture(scope="module")
def raw():
    """Return Playground's own cartpole, stepped by its own function."""
    env = playground.registry.load("CartpoleBalance", config_overrides={"impl": "jax"})
    return jax.jit(jax.vmap(env.step))


def cartpoles(**options) -> envs.Worlds:
    return envs.make(CARTPOLE, 4, "cpu", episode_length=6, **options)


def close(ours: torch.Tensor, theirs) -> None:
    torch.testing.assert_close(ours, torch.from_dlpack(theirs), rtol=0, atol=1e-5)


def test_every_step_is_that_of_the_environment_also_the_last_of_an_episode(raw):
    env, ends = cartpoles(), 0
    for _ in range(15):
        before, action = env._state, noise(env)
        step, theirs = env.step(action), raw(before, jax.numpy.asarray(action.numpy()))
        close(step.final_observation, theirs.obs)
        close(step.reward[:, 0], theirs.reward)
        close(step.terms["upright"], theirs.metrics["reward/upright"])
        torch.testing.assert_close(step.reward[:, 1], -(action[:, 0] ** 2))
        moved = (step.observation != step.final_observation).any(1)
        assert torch.equal(moved, step.truncated) and not step.terminated.any()
        close(step.observation, env._task._features(env._state))
        ends += int(moved.sum())
    assert ends >= 8  # 15 steps of 4 worlds, of 6 steps each at most
    assert env.reward_terms[-4:] == ("small_velocity", "upright", "reward", "action_l2")


def test_the_first_states_are_drawn_from_the_seed():
    env = envs.make(DRIFT, 5, "cpu", seed=3, stagger=False)
    first = env.critic_observation()
    assert len(first[:, 0].unique()) == 5
    env.reseed(3)
    assert torch.equal(env.reset(), first[:, :2]) and not torch.equal(env.reset(), first[:, :2])
    assert not torch.equal(envs.make(DRIFT, 5, "cpu", seed=4).reset(), first[:, :2])
    assert envs.make(DRIFT, 5, "cpu", seed=2**63 + 3).reset().isfinite().all()


def test_worlds_fail_or_run_out_of_time_and_start_anew_each_time():
    env = envs.make(DRIFT, 3, "cpu", stagger=False)
    assert (env.observation_size, env.privileged_size, env.action_size) == (2, 1, 1)
    pushes, starts = torch.tensor([[0.5], [-0.125], [-3.0]]), set()
    for number in range(1, 13):
        x = env.critic_observation()[:, 0] + pushes[:, 0].clamp(-1, 1)
        step = env.step(pushes)
        torch.testing.assert_close(step.final_critic_observation[:, 0], x)
        torch.testing.assert_close(step.final_critic_observation[:, 2], x**2)
        assert step.terminated.tolist() == [False, False, number % 2 == 0]
        assert step.truncated.tolist() == [number % 6 == 0, number % 6 == 0, False]
        over = step.terminated | step.truncated
        assert (step.observation[over, 1] == 0).all() and (step.observation[~over, 1] > 0).all()
        starts |= {*step.observation[over, 0].tolist()}
    assert len(starts) == 10
    assert env._task.step._cache_size() == 1  # JAX did not compile it again for other types


def test_terms_are_what_the_environment_reports_and_its_reward_is_one_of_them():
    objectives = {"go": {"go": 1.0}, "all": {"reward": 1.0, "action_l2": -2.0}}
    changes = ["--task.overrides", "scales.go", "3", "scales.save", "-1.0"]
    config, _, _ = read(["--env", DRIFT, "--device", "cpu", *changes])
    overrides = config.task.overrides
    env = envs.make(DRIFT, 2, "cpu", objectives=objectives, overrides=overrides)
    step = env.step(torch.tensor([[0.5], [-0.5]]))
    assert env.reward_terms == ("go", "save", "reward", "action_l2")
    assert step.terms["go"].tolist() == [1.5, -1.5] and step.terms["save"].tolist() == [-0.5, -0.5]
    torch.testing.assert_close(step.terms["reward"], torch.tensor([0.1, 0.0]))
    torch.testing.assert_close(step.reward, torch.tensor([[1.5, -0.4], [-1.5, -0.5]]))


def test_worlds_that_are_not_finite_terminate_and_earn_nothing():
    check_blown_up(cartpoles())


def test_evaluated_worlds_earn_nothing_once_they_are_over():
    env = envs.make(DRIFT, 3, "cpu", auto_reset=False)
    steps = [env.step(torch.tensor([[0.5], [0.5], [-1.0]])) for _ in range(9)]
    assert steps[5].reward[:2].all() and not steps[6].reward.any()
    env.restart(torch.tensor([True, False, False]))
    again = env.step(torch.full((3, 1), 0.5))
    assert again.truncated.tolist() == [False, True, False] and again.reward[0].all()


def test_a_run_is_trained_evaluated_loaded_and_resumed(tmp_path, capsys):
    check_run(tiny(CARTPOLE, backend=None, worlds=4), tmp_path / "run", capsys)


MISTAKES = [
    ("playground:CartpoleBalanc", {}, "did you mean 'CartpoleBalance'"),
    (DRIFT, {"overrides": {"scale.go": 1.0}}, "key of the config.*did you mean 'scales.go'"),
    (DRIFT, {"overrides": {"shows": "image"}}, "shows pixels/view_0, where .*one vector"),
    (CARTPOLE, {"overrides": {"impl": "fast"}}, "cannot make .*CartpoleBalance: .*'fast' is"),
]


@pytest.mark.parametrize(("name", "options", "message"), MISTAKES)
def test_mistakes_are_one_sentence(name, options, message):
    with pytest.raises(MorlaxError, match=message):
        envs.make(name, 2, "cpu", **options)
