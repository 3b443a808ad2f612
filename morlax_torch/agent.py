"""A family of actors, a family of critics, and the scales they see the world in."""

import math
from collections.abc import Callable
from functools import cached_property

import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from . import fused
from .config import NetworkConfig
from .hypernetwork import Hypernetwork
from .networks import check_network, mlp
from .normalizer import Normalizer

MIN_STD = 1e-3


class TanhNormal:
    """A Gaussian squashed by tanh. Its samples stay unsquashed: `tanh` makes them actions.

    Args:
        output: of the actors, (..., 2A): the means, and what becomes the standard deviations.
    """

    def __init__(self, output: Tensor):
        self.output = output

    @cached_property
    def mean(self) -> Tensor:
        """(..., A)"""
        return self.output.chunk(2, dim=-1)[0]

    @cached_property
    def std(self) -> Tensor:
        """(..., A)"""
        return softplus(self.output.chunk(2, dim=-1)[1]) + MIN_STD

    def noise(self, generator: torch.Generator | None = None) -> Tensor:
        """(..., A) standard normal."""
        shape = *self.output.shape[:-1], self.output.shape[-1] // 2
        return self.output.new_empty(shape).normal_(generator=generator)

    def act(self, generator: torch.Generator | None = None) -> tuple[Tensor, Tensor]:
        """A sample (..., A) and its log-probability (...)."""
        noise = self.noise(generator)
        if noise.is_cuda:
            return fused.act(self.output, noise)
        action = self.mean + self.std * noise
        return action, self.log_prob(action)

    def log_prob(self, action: Tensor) -> Tensor:
        """(..., A) unsquashed to (...): the log-density of tanh(action)."""
        standard = (action - self.mean) / self.std
        gaussian = -0.5 * standard.square() - self.std.log() - 0.5 * math.log(2 * math.pi)
        return (gaussian - _log_slope(action)).sum(-1)

    def entropy(self, noise: Tensor) -> Tensor:
        """(...): the Gaussian's entropy, and what tanh takes from it at one sample."""
        gaussian = 0.5 + 0.5 * math.log(2 * math.pi) + self.std.log()
        return (gaussian + _log_slope(self.mean + self.std * noise)).sum(-1)


def _log_slope(action: Tensor) -> Tensor:
    """log(d tanh(u) / du), in a form that does not overflow."""
    return 2 * (math.log(2) - action - softplus(-2 * action))


class Agent(nn.Module):
    """What training changes: an actor and a critic for every trade-off, and the normalisers.

    `policies` and `values` generate the networks of K trade-offs once and return functions that
    run them, each on its own rows of *normalised* observations. Critics see all of a row, actors
    its first O numbers: the P behind them are privileged.
    """

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        num_objectives: int,
        config: NetworkConfig,
        generator: torch.Generator | None = None,
        *,
        privileged_size: int = 0,
        actor: nn.Module | None = None,
        critic: nn.Module | None = None,
    ):
        super().__init__()
        self.observation_size, self.privileged_size = observation_size, privileged_size
        self.action_size = action_size
        given = {"actor": actor, "critic": critic}
        self._own = [name for name, network in given.items() if network is not None]
        whole = observation_size + privileged_size
        if actor is None:
            actor = mlp(observation_size, config.actor, 2 * action_size, generator)
            spread = math.log(math.expm1(config.initial_std - MIN_STD))  # softplus brings it back
            last = actor.get_parameter(f"{2 * len(config.actor)}.bias")
            nn.init.constant_(last[action_size:], spread)
        else:
            check_network("actor", actor, observation_size, 2 * action_size)
        if critic is None:
            critic = mlp(whole, config.critic, num_objectives, generator)
        else:
            check_network("critic", critic, whole, num_objectives)

        def family(target: nn.Module, features: nn.Module | None = None) -> Hypernetwork:
            return Hypernetwork(
                target,
                num_objectives,
                config.hidden,
                config.features,
                scale=config.scale,
                features=features,
                generator=generator,
            )

        self.actor = family(actor)
        self.critic = family(critic, self.actor.features if config.type == "single" else None)
        self.observation_normalizer = Normalizer(whole)
        self.value_normalizer = Normalizer(num_objectives)

    def own_networks(self) -> dict[str, dict[str, list[int]]]:
        """What parameters the networks have that a user made: name -> parameter -> shape."""
        families = {name: getattr(self, name) for name in self._own}
        return {
            name: {parameter: list(shape) for parameter, shape in family.shapes.items()}
            for name, family in families.items()
        }

    def policies(self, tradeoffs: Tensor) -> Callable[[Tensor], TanhNormal]:
        """(K, m) trade-offs to a function from observations (K, B, O) to action distributions."""
        parameters, size = self.actor(tradeoffs), self.observation_size
        return lambda seen: TanhNormal(self.actor.run(parameters, seen[..., :size]))

    def values(self, tradeoffs: Tensor) -> Callable[[Tensor], Tensor]:
        """(K, m) trade-offs to a function from observations (K, B, O + P) to values (K, B, m).

        The values are in the units of `value_normalizer`.
        """
        parameters = self.critic(tradeoffs)
        return lambda seen: self.critic.run(parameters, seen)
