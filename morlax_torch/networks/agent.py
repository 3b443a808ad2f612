"""Actor and critic families, with their normalizers."""

import copy
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor, nn

from ..configuration.config import Config
from ..configuration.tradeoffs import even_tradeoffs
from ..envs import MorlaxError, Worlds
from ..envs.worlds.design_space import DesignSpace
from ..envs.worlds.mirror import Mirror, Reflection
from ..gpu import fused
from .family import Conditioned, Family, Independent
from .gaussian import TanhNormal, limited, sample, spread_of
from .hypernetwork import Hypernetwork
from .mlp import Symmetric, Twins, check_network, mlp
from .normalizer import Normalizer


class Actors(NamedTuple):
    """The actors of K trade-offs."""

    parameters: dict[str, Tensor]  # (K, ...) each
    family: Family
    normalizer: Normalizer
    max_std: float | None = None

    def distribution(self, observation: Tensor) -> TanhNormal:
        """Map raw observations (K, B, O) to action distributions."""
        return self.of_normalized(self.normalizer(observation))

    def of_normalized(self, observation: Tensor) -> TanhNormal:
        """Map *normalized* observations (K, B, O) to action distributions."""
        output = self.family.run(self.parameters, observation)
        return TanhNormal(output if self.max_std is None else limited(output, self.max_std))

    def explore(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Map raw observations (K, B, O) and normal noise (K, B, A) as `gaussian.sample` does."""
        output = self.distribution(observation).output
        kernels = fused.kernels(output.device)
        return (kernels.sample if kernels else sample)(output, noise)

    def act(self, observation: Tensor) -> Tensor:
        """Map raw observations (K, B, O) to deterministic actions (K, B, A) in (-1, 1)."""
        return self.distribution(observation).mode

    def copy_(self, other: Self, rows: slice = slice(None)) -> None:
        """Copy the numbers of other actors to these rows, in place: recorded graphs read them."""
        for name, values in self.parameters.items():
            values[rows].copy_(other.parameters[name])


class SpecializedPolicy(nn.Module):
    """The policy of one trade-off: raw observations (B, O) to actions (B, A) in (-1, 1)."""

    def __init__(self, normalizer: nn.Module, actor: nn.Module):
        super().__init__()
        self.normalizer, self.actor = normalizer, actor

    def forward(self, observation: Tensor) -> Tensor:
        # the mode of a TanhNormal, in operations that torch.jit.script knows
        return self.actor(self.normalizer(observation)).chunk(2, dim=-1)[0].tanh()


class Agent(nn.Module):
    """Everything that training changes: an actor and a critic for every trade-off, and normalizers.

    Critics see all O + P features of an observation, actors the first O. With `sampling.designs`,
    the body is the context of the networks (see `family`), by default that of `task.design`.

    Args:
        config: the config.
        task: `Worlds`, or the `Task` of a checkpoint, which has their sizes.
        generator: draws the initial parameters.
        actor: replaces the config's actor: a module from (B, O) to (B, 2A). One that is conditioned
            takes m more inputs, the trade-off, and so does the critic.
        critic: replaces the config's critic: a module from (B, O + P) to the values.
        mirror: of the robot, for `network.symmetric`; None: a checkpoint will tell.
    """

    def __init__(
        self,
        config: Config,
        task: Any,
        generator: torch.Generator | None = None,
        *,
        actor: nn.Module | None = None,
        critic: nn.Module | None = None,
        mirror: Mirror | None = None,
    ):
        super().__init__()
        network, m = config.network, len(task.objectives)
        # R, that are independent of each other; 0 of other types
        self.num_networks = config.sampling.clusters if network.type == "independent" else 0
        self.observation_size, self.privileged_size = task.observation_size, task.privileged_size
        self.action_size, self.objectives = task.action_size, tuple(task.objectives)
        self.designs, self._max_std = dict(task.designs), network.max_std
        context = torch.zeros(0, dtype=torch.float32)
        if config.sampling.designs:
            if not self.designs:
                raise MorlaxError(
                    f"sampling.designs is {config.sampling.designs}, but {config.env} declares no "
                    "design parameters: set it to 0, or declare some (docs/designs.md)."
                )
            space = DesignSpace(self.designs)
            context = torch.from_numpy(space.scaled(space.vector(config.task.design))).float()
        # (d,) of the body that the task names; empty without designs
        self.context = nn.Buffer(context, persistent=False)
        self._own = [name for name, x in (("actor", actor), ("critic", critic)) if x is not None]
        self.num_values = 1 if config.ppo.critic == "scalar" else m
        actor, critic = self._networks(actor, critic, config, generator)
        if network.symmetric:
            actor, critic = self._symmetric(actor, critic, config, mirror)
        self.actor: Hypernetwork | Conditioned | Independent
        self.critic: Hypernetwork | Conditioned | Independent
        if network.type == "conditioned":
            self.actor, self.critic = Conditioned(actor, m), Conditioned(critic, m)
        elif network.type == "independent":
            keys = even_tradeoffs(self.num_networks, m)
            self.actor, self.critic = Independent(actor, keys), Independent(critic, keys)
        else:
            make = partial(
                Hypernetwork,
                num_objectives=m,
                hidden_sizes=network.hidden,
                num_features=network.features,
                context_size=len(context),
                scale=network.scale,
                generator=generator,
            )
            self.actor = make(actor)
            shared = self.actor.features if network.type == "single" else None
            self.critic = make(critic, features=shared)
        features = self.observation_size + self.privileged_size
        self.observation_normalizer = Normalizer(features, mirror.observation if mirror else None)
        self.value_normalizer = Normalizer(self.num_values)

    def _networks(
        self,
        actor: nn.Module | None,
        critic: nn.Module | None,
        config: Config,
        generator: torch.Generator | None,
    ) -> tuple[nn.Module, nn.Module]:
        """Return an actor and a critic of one trade-off: a user's, which are checked, or new."""
        network, A = config.network, self.action_size
        m, d = len(self.objectives), len(self.context)
        inputs = self.observation_size + (m + d if network.type == "conditioned" else 0)
        if actor is None:
            actor = mlp(inputs, network.actor, 2 * A, generator)
            weight, bias = list(actor.parameters())[-2:]
            with torch.no_grad():
                weight.mul_(network.output_scale)
                bias[A:] = spread_of(network.initial_std)
        else:
            check_network("actor", actor, inputs, 2 * A)
        inputs += self.privileged_size
        if config.method.off_policy:
            critic = Twins(inputs + A, network.critic, self.num_values, generator)
        elif critic is None:
            critic = mlp(inputs, network.critic, self.num_values, generator)
        else:
            check_network("critic", critic, inputs, self.num_values)
        return actor, critic

    def _symmetric(
        self, actor: nn.Module, critic: nn.Module, config: Config, mirror: Mirror | None
    ) -> tuple[Symmetric, Symmetric]:
        """Let both answer mirrored inputs by mirrored outputs; conditions stay as they are."""
        none, joined, A = Reflection.none, Reflection.joined, self.action_size
        seen, acted = mirror or Mirror(none(self.observation_size + self.privileged_size), none(A))
        m, d = len(self.objectives), len(self.context)
        condition = none(m + d if config.network.type == "conditioned" else 0)
        spread = acted._replace(sign=torch.ones(A, dtype=torch.float32))
        inputs = joined([seen.first(self.observation_size), condition])
        asymmetry = config.network.asymmetry
        actor = Symmetric(actor, inputs, joined([acted, spread]), asymmetry)
        inputs = joined([seen, *([acted] if config.method.off_policy else []), condition])
        values = none(2 * self.num_values if config.method.off_policy else self.num_values)
        return actor, Symmetric(critic, inputs, values, asymmetry)

    def check_sizes(self, env: Worlds) -> None:
        """Raise MorlaxError unless policies can act in these worlds."""
        sizes = self.observation_size, self.action_size
        if sizes != (env.observation_size, env.action_size):
            raise MorlaxError(
                f"the policies take {sizes[0]} observations and return {sizes[1]} actions, but the "
                f"task has {env.observation_size} and {env.action_size}: it has changed since they "
                "were trained. Restore its files, or train anew."
            )

    def own_networks(self) -> dict[str, dict[str, list[int]]]:
        """Return the parameter shapes of user-made networks: network -> parameter -> shape."""
        return {
            name: {key: list(shape) for key, shape in getattr(self, name).shapes.items()}
            for name in self._own
        }

    def conditions(self, tradeoffs: Tensor) -> Tensor:
        """Add the context to trade-offs (..., m); conditions (..., m + d) have their own."""
        if tradeoffs.shape[-1] > len(self.objectives) or not len(self.context):
            return tradeoffs
        context = self.context.expand(*tradeoffs.shape[:-1], -1)
        return torch.cat([tradeoffs, context.to(tradeoffs)], -1)

    def with_context(self, context: Tensor) -> Self:
        """Return an agent with another context (d,), and otherwise the same parameters."""
        other = copy.copy(self)
        other._buffers = {**self._buffers, "context": context.to(self.context)}
        return other

    def actors(self, tradeoffs: Tensor) -> Actors:
        """Generate the actors of K trade-offs (K, m) or conditions (K, m + d)."""
        parameters = self.actor(self.conditions(tradeoffs))
        return Actors(parameters, self.actor, self.observation_normalizer, self._max_std)

    def policies(self, tradeoffs: Tensor) -> Callable[[Tensor], TanhNormal]:
        """Return a function from *normalized* features (K, B, O + P) to action distributions."""
        actors, size = self.actors(tradeoffs), self.observation_size
        return lambda normalized: actors.of_normalized(normalized[..., :size])

    def values(self, tradeoffs: Tensor) -> Callable[[Tensor], Tensor]:
        """Return a function from *normalized* features (K, B, O + P) to such values (K, B, m)."""
        parameters = self.critic(self.conditions(tradeoffs))
        return lambda normalized: self.critic.run(parameters, normalized)

    def specialize(self, tradeoff: Tensor) -> SpecializedPolicy:
        """Return the policy of one trade-off (m,) as a plain module with its own parameters."""
        actor = self.actor.specialize(self.conditions(tradeoff))
        return SpecializedPolicy(copy.deepcopy(self.observation_normalizer), actor)
