"""A hopper that trains in a second, and one whose critic sees more than its policies."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from torch import Tensor, nn

from morlax_torch import Policy, config_for, envs
from morlax_torch.algorithms.registry import make_learner
from morlax_torch.configuration.config import Config
from morlax_torch.configuration.sections import NetworkConfig
from morlax_torch.networks.agent import Agent
from morlax_torch.runs.checkpoint import Task
from morlax_torch.runs.progress import Progress
from morlax_torch.runs.training import Schedule

TYPED = (  # on the command line
    *("--device", "cpu", "--worlds", "32", "--horizon", "5", "--sampling.clusters", "4"),
    *("--ppo.minibatches", "2", "--evaluation.tradeoffs", "6", "--task.episode-length", "10"),
    *("--max-env-steps", "320"),
)
FEW = {  # worlds and steps, for simulators that are slow
    "worlds": 4,
    "horizon": 2,
    "max_env_steps": 8,
    "sampling.clusters": 2,
    "sampling.mode": "dense",
    "ppo.minibatches": 2,
}


def tiny(env: str = "hopper", **changes: Any) -> Config:
    """Return a config for two evaluations, with changes named as on the command line."""
    small = {
        "device": "cpu",
        "backend": "mujoco",
        "worlds": 8,
        "horizon": 4,
        "max_env_steps": 64,
        "sampling.clusters": 4,
        "ppo.minibatches": 1,
        "ppo.epochs": 1,
        "network.hidden": (4,),
        "network.features": 2,
        "network.actor": (4,),
        "network.critic": (4,),
        "evaluation.tradeoffs": 4,
        "evaluation.every": 32,
        "task.episode_length": 5,
    }
    return config_for(env, **{**small, **changes})


def learner(config: Config, iterations: int = 0, **networks: nn.Module) -> Any:
    """Return a learner after so many iterations."""
    made = make_learner(config.make_worlds(config.worlds, config.seed), config, **networks)
    for _ in range(iterations):
        made.iterate()
    return made


def varied(**changes: Any) -> Policy:
    """Return an untrained policy, with changes of its config, whose actions depend on all."""
    config, objectives = tiny(**changes), ("run", "jump")
    agent = Agent(config, Task(objectives=objectives, observation_size=13, action_size=4))
    for parameter in agent.parameters():  # they start equal for all trade-offs
        nn.init.normal_(parameter)
    return Policy(agent, config, objectives)


def iterate(learner: Any, iterations: int) -> None:
    """Run iterations as the training loop does."""
    schedule = Schedule(learner, Progress())
    for _ in range(iterations):
        learner.iterate(schedule.done(0.0))


@contextmanager
def scaled(scale: float = 0.3) -> Iterator[None]:
    """Start hypernetworks whose networks depend on the trade-off."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NetworkConfig, "scale", scale)
        yield


class Blind(envs.get("hopper")):
    """A hopper whose policies see positions only; its critics see velocities too."""

    def observe(self) -> Tensor:
        return self.physics.qpos[:, 1:]

    def privileged(self) -> Tensor | None:
        return self.physics.qvel.clamp(-10, 10)

    def layout(self) -> list[envs.Part]:
        return super().layout()[:6]
