"""A trained family of policies, as other programs use it."""

from collections.abc import Callable, Mapping, Sequence
from typing import Self

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from .. import envs
from ..configuration.config import Config
from ..configuration.tradeoffs import checked_tradeoff, one_tradeoff
from ..envs import MorlaxError, Robot
from ..envs.errors import shortened
from ..envs.worlds.design_space import DesignSpace
from .agent import Agent, SpecializedPolicy


class Policy(nn.Module):
    """The deterministic policies of every trade-off.

    policy(observation, tradeoff) maps (B, O) and (m,) or (B, m) to actions (B, A) in (-1, 1); each
    row may have its own trade-off. Trade-offs need not sum to one, but must not be negative or all
    zero. Observations may be arrays or tensors of any float type. Actions have no gradient, also in
    `torch.func`; those of `specialize` have one.

    Raises:
        MorlaxError: an observation or trade-off has the wrong shape, type or numbers.
    """

    model_fingerprint: Mapping[str, str] = {}  # of the MuJoCo model trained with; empty: unknown

    def __init__(self, agent: Agent, config: Config, objectives: Sequence[str]):
        super().__init__()
        self.agent, self.config, self.objectives = agent, config, tuple(objectives)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        # `.to`, `.cuda` and their like move all tensors so
        dtype = fn(torch.zeros((), dtype=torch.float32, device="cpu")).dtype
        if dtype != torch.float32:
            raise MorlaxError(
                f"policies compute in float32, not {dtype}: convert their actions, or the policy "
                "of one trade-off, policy.specialize(tradeoff)."
            )
        return super()._apply(fn, recurse)

    @torch.no_grad()
    def forward(
        self, observation: Tensor | ArrayLike, tradeoff: Tensor | Sequence[float]
    ) -> Tensor:
        observation = self._checked(observation)
        tradeoff = checked_tradeoff(tradeoff, self.objectives, observation.device)
        rows = observation.reshape(-1, self.agent.observation_size)
        if tradeoff.ndim == 1:  # one policy for all rows
            tradeoff, rows = tradeoff[None], rows[None]
        elif len(tradeoff) == len(rows):
            rows = rows[:, None]
        else:
            raise MorlaxError(
                f"the number of observations is {len(rows)}, but that of trade-offs "
                f"{len(tradeoff)}: give one per observation, or one for all."
            )
        with torch.autocast(self.device.type, enabled=False):  # that a user may have enabled
            actions = self.agent.actors(tradeoff).act(rows)
        return actions.reshape(*observation.shape[:-1], self.agent.action_size)

    def for_design(self, design: Mapping[str, float]) -> "Policy":
        """Return the policies of another body: that with these design parameters, by name.

        Parameters that are not named have their defaults. The result shares the networks; its
        config names the design, so that it is evaluated, shown and exported with that body.

        Raises:
            MorlaxError: these policies are of one body, or a parameter is unknown or out of range.
        """
        if not len(self.agent.context):
            raise MorlaxError("these policies were trained with one body, so they know no others.")
        space = DesignSpace(self.agent.designs)
        agent = self.agent.with_context(torch.from_numpy(space.scaled(space.vector(design))))
        plain = {name: float(value) for name, value in design.items()}
        return Policy(agent, self.config.with_task(design=plain), self.objectives)

    def make_robot(self, seed: int = 0) -> Robot:
        """Make one robot of the task, with the body of these policies."""
        task = self.config.task.for_evaluation()
        robot = envs.make_robot(self.config.env, seed, **task.model_dump())
        self.agent.check_sizes(robot)
        return robot

    def reward_weights(self, tradeoff: Tensor | Sequence[float]) -> dict[str, float]:
        """Return the weight of every reward term that the policy of a trade-off (m,) learned from.

        They weigh the terms as the config of the task does, for training of one policy elsewhere.

        Raises:
            MorlaxError: the scalarization is not linear, or the trade-off is invalid.
        """
        if self.config.scalarization != "linear":
            raise MorlaxError(
                f"policies of the scalarization {self.config.scalarization} did not learn from "
                "fixed weights."
            )
        weights = one_tradeoff(tradeoff, self.objectives, torch.device("cpu")).double()
        task, total = self.config.task, dict[str, float]()
        parts = zip((weights / weights.sum()).tolist(), task.objectives.values(), strict=True)
        for share, terms in [(1.0, task.shared), (1.0, task.guide), *parts]:
            for name, weight in terms.items():
                total[name] = total.get(name, 0.0) + share * weight
        return total

    def _checked(self, observation: Tensor | ArrayLike) -> Tensor:
        """Convert observations (B, O) or (O,) to float32; arrays move to the policy's device."""
        if not isinstance(observation, Tensor):
            try:
                array = np.asarray(observation)
                if array.dtype.kind == "f":  # torch takes no negative strides or other byte order
                    array = np.array(array, np.float32, order="C")
                observation = torch.as_tensor(array, device=self.device)
            except (TypeError, ValueError):
                raise MorlaxError(
                    f"observations consist of numbers, not {shortened(observation)}."
                ) from None
        size = self.agent.observation_size
        if observation.ndim not in (1, 2) or observation.shape[-1] != size:
            raise MorlaxError(
                f"observations have the shape {tuple(observation.shape)}, but this policy needs "
                f"(B, {size}): {size} numbers for each of B robots."
            )
        if not observation.is_floating_point():
            raise MorlaxError(f"observations must be floats, not {observation.dtype}.")
        return observation.float()

    @property
    def device(self) -> torch.device:
        return self.agent.observation_normalizer.mean.device

    def specialize(self, tradeoff: Tensor | Sequence[float]) -> SpecializedPolicy:
        """Return a plain module for one trade-off (m,), with normalizer and tanh inside."""
        tradeoff = one_tradeoff(tradeoff, self.objectives, self.device)
        with torch.autocast(self.device.type, enabled=False):
            return self.agent.specialize(tradeoff).requires_grad_(False)
