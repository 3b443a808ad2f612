"""rsl_rl's runner trains in the package's worlds."""

from importlib.util import find_spec
from typing import Any

import pytest
import torch
from closed_form import OneStep
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from morlax_torch import envs

pytestmark = [
    pytest.mark.usefixtures("single_thread"),
    pytest.mark.skipif(find_spec("rsl_rl") is None, reason="rsl_rl is not installed"),
]
TRADEOFF = (0.7, 0.3)


def worlds(task: str = "walker", num_envs: int = 4, tradeoff=TRADEOFF, **options) -> Any:
    from morlax_torch.adapters.rsl_rl import RslRlVecEnv

    return RslRlVecEnv(task, tradeoff, num_envs, "cpu", **options)


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


@pytest.mark.slow
def test_rsl_rl_ppo_learns_to_run_and_logs_each_objective(tmp_path, capsys):
    from rsl_rl.runners import OnPolicyRunner  # imports for seconds

    env = worlds("hopper", 64, (1.0, 0.0), episode_length=100)
    OnPolicyRunner(env, settings(), str(tmp_path), "cpu").learn(14)
    logged = EventAccumulator(str(tmp_path)).Reload()
    run, jump, reward = (
        [event.value for event in logged.Scalars(tag)]
        for tag in ("Return/run", "Return/jump", "Train/mean_reward")
    )
    assert run[-1] > 2 * run[0] and len(jump) == len(run)
    assert reward[0] == pytest.approx(run[0], rel=1e-2)  # rsl_rl's own sum of rewards
    assert "Return/jump" in capsys.readouterr().out


def test_episodes_can_start_at_any_step_and_log_writers_get_the_arguments():
    env = worlds("cheetah", episode_length=9)
    expected = {"task": "cheetah", "tradeoff": [0.7, 0.3], "num_envs": 4, "episode_length": 9}
    assert env.cfg.to_dict() == expected
    assert env.max_episode_length == 9
    env.episode_length_buf = torch.tensor([0, 3, 6, 8])
    ends = [env.step(torch.zeros(4, 6))[2].nonzero().squeeze(-1).tolist() for _ in range(9)]
    assert ends == [[3], [], [2], [], [], [1], [], [], [0]]
    assert env.episode_length_buf.tolist() == [0, 3, 6, 8]
    env.episode_length_buf[1:3] = 8  # as in Isaac Lab, also in place
    assert env.step(torch.zeros(4, 6))[2].tolist() == [0, 1, 1, 1]


def test_any_worlds_tell_curiosity_their_control_step():
    class Quick(OneStep):
        dt = 0.5  # s

    envs.register("quick", Quick)
    envs.register("untimed", OneStep)
    assert [worlds(task).step_dt for task in ("quick", "untimed", "walker")] == [0.5, 1.0, 0.01]
