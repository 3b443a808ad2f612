"""What the tests of the learning core share: generators, agents and rollouts of random numbers."""

from collections.abc import Callable

import pytest
import torch

from morlax_torch import MorlaxError, Policy, envs
from morlax_torch.agent import Agent
from morlax_torch.config import NetworkConfig, load_config, task_values
from morlax_torch.rendering import choose_opengl
from morlax_torch.rollout import Rollout


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


@pytest.fixture
def make_agent() -> Callable[..., Agent]:
    """Small agents whose policies and values differ between trade-offs from the start."""

    def make(
        observation_size: int = 3,
        action_size: int = 2,
        num_objectives: int = 2,
        seed: int = 0,
        **network: object,
    ) -> Agent:
        sizes = {"hidden": (8,), "features": 4, "scale": 0.3, "actor": (6, 5), "critic": (7,)}
        config = NetworkConfig.model_validate({**sizes, **network})
        generator = torch.Generator().manual_seed(seed)
        return Agent(observation_size, action_size, num_objectives, config, generator)

    return make


@pytest.fixture
def make_rollout(generator: torch.Generator) -> Callable[..., Rollout]:
    """Rollouts of noise, in which some steps terminate and some others are truncated."""

    def make(
        horizon: int = 12,
        clusters: int = 3,
        worlds: int = 4,
        observation_size: int = 3,
        action_size: int = 2,
        num_objectives: int = 2,
    ) -> Rollout:
        def noise(*shape: int) -> torch.Tensor:
            return torch.randn(horizon, clusters, worlds, *shape, generator=generator)

        fate = torch.rand(horizon, clusters, worlds, generator=generator)
        return Rollout(
            observation=noise(observation_size),
            action=noise(action_size),
            log_prob=noise(),
            reward=noise(num_objectives),
            terminated=fate < 0.15,
            truncated=fate > 0.85,
            final_observation=noise(observation_size),
        )

    return make


@pytest.fixture
def make_policy() -> Callable[..., Policy]:
    """Untrained families of policies that move a task's robot, each trade-off in its own way."""

    def make(task: str = "hopper") -> Policy:
        config = load_config(task_values(task, "cpu"))
        env = envs.make(task, 1, "cpu")
        generator = torch.Generator().manual_seed(0)
        sizes = env.observation_size, env.action_size, len(env.objectives)
        agent = Agent(*sizes, config.network, generator)
        torch.nn.init.normal_(agent.actor.weight, std=0.2, generator=generator)
        return Policy(agent, config, env.objectives)

    return make


@pytest.fixture
def opengl() -> None:
    """Something to draw with."""
    try:
        choose_opengl()
    except MorlaxError as error:
        pytest.skip(str(error))
