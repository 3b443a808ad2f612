"""Actor and critic families, with their normalizers."""

import copy
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple, Self

import torch
from torch import Tensor, nn

from ..configuration.config import Config
from ..configuration.tradeoffs import even_tradeoffs
from ..envs import MorlaxError, Worlds
from ..envs.worlds.design_space import DesignParameter, DesignSpace
from ..envs.worlds.mirror import Mirror, Reflection
from .conditioned import Conditioned
from .family import Family
from .gaussian import TanhNormal, limited, sample, spread_of
from .generated import Independent, InOrder
from .hypernetwork import Hypernetwork
from .mlp import check_network, mlp
from .normalizer import Normalizer
from .symmetric import Symmetric
from .twins import Twins


class Actors(NamedTuple):
    """The actors of K trade-offs: generated parameters, their family and the normalizer."""

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
        """Sample actions before the tanh (K, B, A), with their log-probabilities (K, B).

        Args:
            observation: raw, (K, B, O).
            noise: standard normal, (K, B, A).
        """
        return sample(self.distribution(observation).output, noise)

    def act(self, observation: Tensor) -> Tensor:
        """Map raw observations (K, B, O) to deterministic actions (K, B, A) in (-1, 1)."""
        return self.distribution(observation).mode

    def copy_(self, other: Self, rows: slice = slice(None)) -> None:
        """Copy the numbers of other actors to these rows, in place: recorded graphs read them."""
        for name, values in other.parameters.items():
            self.parameters[name][rows].copy_(values)
        if self.normalizer is not other.normalizer:  # else it is the agent's own, always up to date
            for mine, values in zip(
                self.normalizer.statistics(), other.normalizer.statistics(), strict=True
            ):
                mine[rows].copy_(values)


def normalizer_for(actor: Family, normalizer: Normalizer, tradeoffs: Tensor) -> Normalizer:
    """Return the observation normalizer of the actors of trade-offs (K, m), or of one (m,).

    That is the one normalizer of an agent, or rows of it, chosen like the actors' networks.
    """
    if normalizer.rows and isinstance(actor, Independent):
        return normalizer.select(actor.chosen(tradeoffs))
    return normalizer


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

    Critics see all O + P features of an observation, actors the first O: the last P are
    privileged. There are A actions and m objectives. The generator draws the initial parameters.

    Args:
        actor: replaces the config's actor: a module from (B, O) to (B, 2A). One that is conditioned
            takes m more inputs, the trade-off, and so does the critic.
        critic: replaces the config's critic: a module from (B, O + P) to the values.
        mirror: of the robot, for `network.symmetric`; None: a checkpoint will tell.
        designs: parameters of the robot's body. With `sampling.designs`, the body is the context of
            the networks (see `family`), by default that of `task.design`.
        in_order: have so many independent networks, and give the k-th of as many trade-offs the
            k-th one, instead of the one for that trade-off.

    Raises:
        MorlaxError: an actor or critic has the wrong sizes, or there are no design parameters.
    """

    def __init__(
        self,
        config: Config,
        observation_size: int,
        action_size: int,
        num_objectives: int,
        generator: torch.Generator | None = None,
        *,
        privileged_size: int = 0,
        actor: nn.Module | None = None,
        critic: nn.Module | None = None,
        mirror: Mirror | None = None,
        in_order: int = 0,
        designs: Mapping[str, DesignParameter] = MappingProxyType({}),
    ):
        super().__init__()
        self.num_networks = num_networks = in_order or config.num_networks
        num_values, sizes = config.num_values(num_objectives), config.network
        self.observation_size, self.privileged_size = observation_size, privileged_size
        self.action_size, self._max_std = action_size, sizes.max_std
        self.num_objectives = num_objectives
        self.designs = dict(designs)
        self.context: Tensor  # (d,)
        self.register_buffer("context", _context(self.designs, config), persistent=False)
        context_size = len(self.context)
        given = {"actor": actor, "critic": critic}
        self._own = [name for name, network in given.items() if network is not None]
        whole = observation_size + privileged_size
        conditions = num_objectives + context_size if sizes.type == "conditioned" else 0
        actor_inputs, critic_inputs = observation_size + conditions, whole + conditions
        if actor is None:
            actor = mlp(actor_inputs, sizes.actor, 2 * action_size, generator)
            last = f"{2 * len(sizes.actor)}"
            with torch.no_grad():
                actor.get_parameter(f"{last}.weight").mul_(sizes.output_scale)
                actor.get_parameter(f"{last}.bias")[action_size:] = spread_of(sizes.initial_std)
        else:
            check_network("actor", actor, actor_inputs, 2 * action_size)
        if config.off_policy:
            critic = Twins(critic_inputs + action_size, sizes.critic, num_values, generator)
        elif critic is None:
            critic = mlp(critic_inputs, sizes.critic, num_values, generator)
        else:
            check_network("critic", critic, critic_inputs, num_values)
        if sizes.symmetric:
            none = Reflection.none
            seen, acted = mirror or Mirror(none(whole), none(action_size))
            spread = acted._replace(sign=torch.ones(action_size, dtype=torch.float32))
            outputs = Reflection.joined([acted, spread])
            inputs = [seen.first(observation_size), none(conditions)]
            actor = Symmetric(actor, Reflection.joined(inputs), outputs, sizes.asymmetry)
            inputs = [seen, *([acted] if config.off_policy else []), none(conditions)]
            values = none(2 * num_values if config.off_policy else num_values)
            critic = Symmetric(critic, Reflection.joined(inputs), values, sizes.asymmetry)

        def family(target: nn.Module, features: nn.Module | None = None) -> Hypernetwork:
            return Hypernetwork(
                target,
                num_objectives,
                sizes.hidden,
                sizes.features,
                context_size=context_size,
                scale=sizes.scale,
                features=features,
                generator=generator,
            )

        self.actor: Hypernetwork | Conditioned | InOrder
        self.critic: Hypernetwork | Conditioned | InOrder
        if sizes.type == "conditioned":
            self.actor, self.critic = (Conditioned(p, num_objectives) for p in (actor, critic))
        elif in_order:
            self.actor, self.critic = (InOrder(part, num_networks) for part in (actor, critic))
        elif sizes.type == "independent":
            keys = even_tradeoffs(num_networks, num_objectives)
            self.actor, self.critic = Independent(actor, keys), Independent(critic, keys)
        else:
            self.actor = family(actor)
            shared = self.actor.features if sizes.type == "single" else None
            self.critic = family(critic, shared)
        rows = num_networks if config.own_statistics else 0
        reflection = mirror.observation if mirror and sizes.symmetric else None
        self.observation_normalizer = Normalizer(whole, rows, reflection)
        self.value_normalizer = Normalizer(num_values, rows)

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
        families = {name: getattr(self, name) for name in self._own}
        return {
            name: {parameter: list(shape) for parameter, shape in family.shapes.items()}
            for name, family in families.items()
        }

    def conditions(self, tradeoffs: Tensor) -> Tensor:
        """Return trade-offs (..., m) with the agent's context, (..., m + d).

        What has a context of its own already, (..., m + d), stays as it is.
        """
        if tradeoffs.shape[-1] > self.num_objectives or not len(self.context):
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
        normalizer = normalizer_for(self.actor, self.observation_normalizer, tradeoffs)
        return Actors(self.actor(self.conditions(tradeoffs)), self.actor, normalizer, self._max_std)

    def policies(self, tradeoffs: Tensor) -> Callable[[Tensor], TanhNormal]:
        """Generate the actors of K trade-offs (K, m) or conditions (K, m + d).

        Returns:
            A function from *normalized* features (K, B, O + P) to action distributions.
        """
        actors, size = self.actors(tradeoffs), self.observation_size
        return lambda normalized: actors.of_normalized(normalized[..., :size])

    def values(self, tradeoffs: Tensor) -> Callable[[Tensor], Tensor]:
        """Generate the critics of K trade-offs (K, m) or conditions (K, m + d).

        Returns:
            A function from *normalized* features (K, B, O + P) to values (K, B, m), in the units of
            `value_normalizer`.
        """
        parameters = self.critic(self.conditions(tradeoffs))
        return lambda normalized: self.critic.run(parameters, normalized)

    def specialize(self, tradeoff: Tensor) -> SpecializedPolicy:
        """Return the policy of one trade-off (m,) as a plain module with its own parameters."""
        normalizer = normalizer_for(self.actor, self.observation_normalizer, tradeoff)
        actor = self.actor.specialize(self.conditions(tradeoff))
        return SpecializedPolicy(copy.deepcopy(normalizer), actor)


def _context(designs: Mapping[str, DesignParameter], config: Config) -> Tensor:
    """Return the context (d,) of the body that the config's task names; empty without designs."""
    if not config.sampling.designs:
        return torch.zeros(0, dtype=torch.float32)
    if not designs:
        raise MorlaxError(
            f"sampling.designs is {config.sampling.designs}, but {config.env} declares no design "
            "parameters: set it to 0, or declare some (docs/designs.md)."
        )
    space = DesignSpace(designs)
    return torch.from_numpy(space.scaled(space.vector(config.task.design))).float()
