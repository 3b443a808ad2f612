"""rsl_rl's runner trains in the package's worlds."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from morlax_torch import MorlaxError, envs
from morlax_torch.envs.robots.planar import Hopper

pytest.importorskip("rsl_rl", reason="rsl_rl is not installed")

from rsl_rl.runners import OnPolicyRunner
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from toppling import falling

from morlax_torch.adapters.rsl_rl import RslRlVecEnv

pytestmark = pytest.mark.usefixtures("single_thread")
TRADEOFF = (0.7, 0.3)
# in a process of its own, because Weights & Biases changes TensorBoard for the whole process
TRAIN_LOGGED = """
import json, sys
from rsl_rl.runners import OnPolicyRunner
from morlax_torch.adapters.rsl_rl import RslRlVecEnv
logger = {"class_name": "WandbLogWriter", "project_name": "morlax"}
env = RslRlVecEnv("hopper", (0.7, 0.3), 16, "cpu", episode_length=5)
OnPolicyRunner(env, {**json.loads(sys.argv[1]), "logger": logger}, ".", "cpu").learn(2)
"""


def worlds(task: str = "walker", num_envs: int = 4, **options) -> RslRlVecEnv:
    return RslRlVecEnv(task, TRADEOFF, num_envs, "cpu", **options)


def settings(**groups: list[str]) -> dict:
    network = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "tanh"}
    spread = {"class_name": "GaussianDistribution", "init_std": 1.0}
    return {
        "num_steps_per_env": 50,
        "save_interval": 1000,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"], **groups},
        "actor": {**network, "distribution_cfg": spread},
        "critic": dict(network),
        "algorithm": {"class_name": "PPO", "gamma": 0.97, "entropy_coef": 0.0},
    }


def test_rsl_rl_ppo_learns_to_run_and_logs_each_objective(tmp_path, capsys):
    torch.manual_seed(0)
    env = RslRlVecEnv("hopper", (1.0, 0.0), 64, "cpu", episode_length=100)
    runner = OnPolicyRunner(env, settings(), log_dir=str(tmp_path), device="cpu")
    runner.learn(20)
    logged = EventAccumulator(str(tmp_path)).Reload()
    run, jump, reward = (
        [event.value for event in logged.Scalars(tag)]
        for tag in ("Return/run", "Return/jump", "Train/mean_reward")
    )
    assert run[-1] > 2 * run[0] and len(jump) == len(run)
    assert reward[0] == pytest.approx(run[0], rel=1e-2)  # rsl_rl's own sum of rewards
    assert "Return/jump" in capsys.readouterr().out

    policy = runner.get_inference_policy("cpu")
    paid = torch.zeros(64)
    with torch.no_grad():
        for _ in range(100):
            _, reward, _, _ = env.step(policy(env.get_observations()))
            paid += reward
    assert paid.mean() > 2 * run[0]


def test_a_step_matches_the_package_s_worlds():
    env, reference = worlds(episode_length=100), envs.make("walker", 4, "cpu", episode_length=100)
    assert torch.equal(env.get_observations()["policy"], reference.reset())
    timed_out, fallen = 0, 0
    for _ in range(110):
        observation, reward, done, extras = env.step(falling())
        step = reference.step(falling())
        assert torch.equal(observation["policy"], step.observation)
        assert torch.equal(extras["objectives"], step.reward)
        np.testing.assert_allclose(reward, step.reward @ torch.tensor(TRADEOFF), rtol=1e-5)
        assert torch.equal(done.bool(), step.terminated | step.truncated)
        assert torch.equal(extras["time_outs"], step.truncated)
        assert ("log" in extras) == done.any()
        timed_out, fallen = timed_out + step.truncated.sum(), fallen + step.terminated.sum()
    assert timed_out == 1 and fallen >= 3


def test_actions_are_clipped():
    once, wildly = worlds("hopper"), worlds("hopper")
    for _ in range(5):
        expected, *_ = once.step(torch.ones(4, 4))
        observation, *_ = wildly.step(torch.full((4, 4), 9.0))
    assert torch.equal(observation["policy"], expected["policy"])


def test_episodes_can_start_at_any_step():
    env = worlds("cheetah", episode_length=9)
    assert env.max_episode_length == 9
    env.episode_length_buf = torch.tensor([0, 3, 6, 8])
    ends = [env.step(torch.zeros(4, 6))[2].nonzero().squeeze(-1).tolist() for _ in range(9)]
    assert ends == [[3], [], [2], [], [], [1], [], [], [0]]
    assert env.episode_length_buf.tolist() == [0, 3, 6, 8]


def test_critics_see_privileged_observations(monkeypatch):
    class Blind(Hopper):
        """A hopper whose policy sees only positions; its critic also sees velocities."""

        def observe(self):
            return self.physics.qpos[:, 1:]

        def privileged(self):
            return self.physics.qvel

        def layout(self):
            return [envs.Part("joints", 6, "rad")]

    monkeypatch.setattr(envs.registry, "_REGISTRY", {**envs.registry._REGISTRY, "blind": Blind})
    env = worlds("blind")
    runner = OnPolicyRunner(env, settings(critic=["critic"]), device="cpu")
    runner.learn(1)
    seen = env.get_observations()
    assert seen["policy"].shape == (4, 6) and seen["critic"].shape == (4, 13)
    assert torch.equal(seen["critic"][:, :6], seen["policy"])


def test_recurrent_policies_and_random_network_distillation_train(tmp_path):
    env = worlds("hopper", 16, episode_length=50)
    chosen = settings(rnd_state=["policy"])
    memory = {"rnn_type": "gru", "rnn_hidden_dim": 8, "rnn_num_layers": 1}
    for network in ("actor", "critic"):
        chosen[network] |= {"class_name": "RNNModel", **memory}
    sizes = {"num_outputs": 4, "predictor_hidden_dims": [8], "target_hidden_dims": [8]}
    chosen["algorithm"]["rnd_cfg"] = {"weight": 100.0, **sizes}
    runner = OnPolicyRunner(env, chosen, log_dir=str(tmp_path), device="cpu")
    assert runner.alg.rnd.initial_weight == pytest.approx(100.0 * env.vector.worlds.dt)
    runner.learn(2, init_at_random_ep_len=True)
    assert "Rnd/mean_intrinsic_reward" in EventAccumulator(str(tmp_path)).Reload().Tags()["scalars"]


def test_rsl_rl_logs_to_weights_and_biases(tmp_path):
    pytest.importorskip("wandb")
    done = subprocess.run(
        [sys.executable, "-c", TRAIN_LOGGED, json.dumps(settings())],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "WANDB_MODE": "offline"},
    )
    assert done.returncode == 0, done.stderr
    (log,) = tmp_path.glob("wandb/offline-run-*/*.wandb")
    assert b"Return/jump" in log.read_bytes() and b"env_cfg" in log.read_bytes()


def test_the_seed_determines_the_randomized_models():
    masses = []
    for seed in (1, 1, 2):
        env = worlds("hopper", seed=seed, randomization={"mass": (0.5, 1.5)})
        masses.append(env.vector.worlds.state_dict()["model.body_mass"])
    assert torch.equal(masses[0], masses[1]) and not torch.equal(masses[0], masses[2])


def test_the_seed_determines_the_initial_states():
    first, same, other = (
        worlds(reset_noise=0.1, seed=seed).get_observations()["policy"] for seed in (3, 3, 4)
    )
    assert torch.equal(first, same) and not torch.equal(first, other)


MISTAKES = {
    "option": (lambda: worlds(episode_lenght=3), "did you mean 'episode_length'"),
    "trade-off": (lambda: RslRlVecEnv("ant", (1.0,)), "needs 2 numbers"),
    "shape": (lambda: worlds().step(falling(5)), "the shape (4, 6)"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_raises_a_clear_error(name):
    mistake, expected = MISTAKES[name]
    with pytest.raises(MorlaxError) as error:
        mistake()
    assert expected in str(error.value)
