"""skrl trains in the package's worlds."""

import pytest
import torch

pytest.importorskip("skrl", reason="skrl is not installed")

from skrl.agents.torch.ppo import PPO
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch import nn

from morlax_torch.adapters.skrl import SkrlEnv

pytestmark = pytest.mark.usefixtures("single_thread")


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
