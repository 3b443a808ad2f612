"""skrl trains in the package's worlds."""

import gymnasium
import pytest
import torch

pytest.importorskip("skrl", reason="skrl is not installed")

from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from toppling import falling
from torch import nn

from morlax_torch.adapters.skrl import SkrlEnv

pytestmark = pytest.mark.usefixtures("single_thread")
TRADEOFF = (0.7, 0.3)


def worlds(task: str = "walker", num_envs: int = 4, **options) -> SkrlEnv:
    return SkrlEnv(task, TRADEOFF, num_envs, "cpu", **options)


class Actor(GaussianMixin, Model):
    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.net = nn.Sequential(
            nn.Linear(self.num_observations, 64), nn.Tanh(), nn.Linear(64, self.num_actions)
        )
        self.log_std = nn.Parameter(torch.zeros(self.num_actions))

    def compute(self, inputs, role):
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = nn.Sequential(nn.Linear(self.num_observations, 64), nn.Tanh(), nn.Linear(64, 1))

    def compute(self, inputs, role):
        return self.net(inputs["observations"]), {}


def train(env: SkrlEnv, steps: int, folder: str) -> None:
    torch.manual_seed(0)
    logged = {"directory": folder, "experiment_name": "run"}
    logged |= {"write_interval": 100, "checkpoint_interval": 0}
    cfg = {"rollouts": 50, "mini_batches": 4, "discount_factor": 0.97, "experiment": logged}
    names = ("observation_space", "state_space", "action_space", "device")
    spaces = {name: getattr(env, name) for name in names}
    agent = PPO(
        models={"policy": Actor(**spaces), "value": Critic(**spaces)},
        memory=RandomMemory(memory_size=50, num_envs=env.num_envs, device=env.device),
        cfg=cfg,
        **spaces,
    )
    cfg = {"timesteps": steps, "headless": True, "disable_progressbar": True}
    cfg |= {"close_environment_at_exit": False}  # it would log after pytest has closed its output
    SequentialTrainer(env=env, agents=agent, cfg=cfg).train()
    agent.writer.close()  # a thread of its own writes the events


@pytest.mark.slow
def test_skrl_ppo_learns_to_run_and_logs_each_objective(tmp_path):
    env = SkrlEnv("hopper", (1.0, 0.0), 64, "cpu", episode_length=100)
    train(env, 700, str(tmp_path))
    logged = EventAccumulator(str(tmp_path / "run")).Reload()
    tags = {tag.split("/ ")[-1]: tag for tag in logged.Tags()["scalars"]}
    run = [event.value for event in logged.Scalars(tags["run"])]
    assert run[-1] > 2 * run[0]
    assert len(logged.Scalars(tags["jump"])) == len(run)


@pytest.mark.filterwarnings("ignore:.*copy construct from a tensor:UserWarning")
def test_wrap_env_accepts_the_gymnasium_environments():
    options = {"tradeoff": TRADEOFF, "episode_length": 5}
    single = wrap_env(gymnasium.make("morlax_torch/Walker-v0", **options), verbose=False)
    vector = wrap_env(
        gymnasium.make_vec("morlax_torch/Walker-v0", num_envs=4, device="cpu", **options),
        verbose=False,
    )
    reference = worlds(episode_length=5)
    assert torch.equal(single.reset()[0], vector.reset()[0][:1])
    for _ in range(5):
        seen, reward, _, truncated, _ = vector.step(falling())
        _, alone_reward, _, over, _ = single.step(falling()[:1])
        expected, expected_reward, *_ = reference.step(falling())
        assert torch.equal(seen, expected) and torch.equal(reward, expected_reward)
        torch.testing.assert_close(alone_reward, reward[:1])
        assert torch.equal(over, truncated[:1])
        assert single.render() is None and vector.render() is None
    assert truncated.all()
