"""Worlds that another library steps."""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from ..errors import MorlaxError
from ..worlds import checks
from ..worlds.interface import TimeStep, Worlds

ACTORS = ("actor", "policy")  # names of the group that a policy sees
CRITIC = "critic"  # what only critics see


class Outcome(NamedTuple):
    """The outcome of one step of N worlds."""

    seen: Tensor  # (N, O + P) after restarts, if there were any
    final: Tensor  # (N, O + P) after the step, before any restart
    terms: Tensor  # (N, terms)
    failed: Tensor  # (N,) bool
    timed_out: Tensor  # (N,) bool, not where a world has failed
    blown_up: Tensor  # (N,) bool, those that have failed because they are not finite


class ForeignWorlds(Worlds):
    """N worlds of another library. Their episodes are not saved: they restart in a resumed run.

    Without automatic reset, a world whose episode is over earns nothing and shows how it ended. A
    world that is not finite terminates with zero reward.
    """

    name: ClassVar[str]  # for error messages
    may_recover = False
    groups: tuple[str, ...]  # of observations, of policies first, in a library that has them

    def __init__(
        self,
        options: Any,
        num_worlds: int,
        device: torch.device,
        seed: int = 0,
        auto_reset: bool = True,
    ):
        super().__init__(options, num_worlds, device, seed, auto_reset)
        self._open(seed)
        self.define_objectives()
        # in place, since a recorded step reads what the one before wrote
        self._over = torch.zeros(2, num_worlds, dtype=torch.bool, device=device)  # failed, late
        features = self.observation_size + self.privileged_size
        self._seen = torch.zeros(num_worlds, features, dtype=torch.float32, device=device)
        self.reset()

    @abstractmethod
    def _open(self, seed: int) -> None:
        """Make the worlds; set their sizes and `reward_terms`."""

    @abstractmethod
    def _restart(self, which: Tensor, seen: Tensor) -> Tensor:
        """Start the worlds of a mask (N,); returns `seen` (N, O + P) with what critics see now."""

    @abstractmethod
    def _advance(self, action: Tensor) -> Outcome:
        """Step every world; with automatic reset, also restart those whose episode is over."""

    def restart(self, which: Tensor) -> Tensor:
        checks.mask(self, which)
        self._seen.copy_(self._restart(which, self._seen))
        self._over &= ~which
        return self._policy(self._seen.clone())

    def step(self, action: Tensor) -> TimeStep:
        standing = self._over.any(0)  # none with automatic reset
        seen, final, paid, failed, timed_out, blown_up = self._advance(action)
        blown_up = blown_up & ~standing
        paid = torch.where((standing | blown_up)[:, None], 0.0, paid)
        final = torch.where(blown_up[:, None], 0.0, final)
        if not self.auto_reset:
            final = torch.where(standing[:, None], self._seen, final)
            self._over.copy_(torch.where(standing, self._over, torch.stack([failed, timed_out])))
            failed, timed_out = self._over.clone()
            seen = torch.where((failed | timed_out)[:, None], final, seen)
        self._seen.copy_(seen)
        self.blowups += blown_up.sum()
        return TimeStep(
            observation=self._policy(seen),
            reward=self._combine(paid),
            terminated=failed,
            truncated=timed_out,
            final_observation=self._policy(final),
            terms=dict(zip(self.reward_terms, paid.unbind(1), strict=True)),
            critic_observation=seen,
            final_critic_observation=final,
            blown_up=blown_up,
        )

    def critic_observation(self) -> Tensor:
        return self._seen.clone()

    def _size(self, groups: Any) -> None:
        """Find the groups of observations (N, size) of policies and critics, and set the sizes."""
        names = list(groups.keys())
        actor = next((name for name in ACTORS if name in names), None)
        if actor is None:
            raise MorlaxError(
                f"{self.name} has no observations called actor or policy, but {', '.join(names)}."
            )
        self.groups = (actor, CRITIC) if CRITIC in names else (actor,)
        for name in self.groups:
            if not isinstance(groups[name], Tensor) or groups[name].ndim != 2:
                raise MorlaxError(
                    f"the observations {name} of {self.name} are not one vector for each world: "
                    "policies cannot take images or parts that are not concatenated."
                )
        self.observation_size = groups[actor].shape[1]
        self.privileged_size = sum(groups[name].shape[1] for name in self.groups[1:])

    def _joined(self, groups: Any) -> Tensor:
        """Return what a policy sees, then what only critics see, (N, O + P)."""
        return torch.cat([groups[name] for name in self.groups], 1).float()
