"""The interface between a learner and many copies of a task, whatever simulates them."""

import math
from abc import ABC, abstractmethod
from functools import wraps
from typing import Any, ClassVar, NamedTuple, NoReturn, Self

import numpy as np
import torch
from torch import Tensor

from ..errors import MorlaxError, unknown
from . import checks
from .design_space import DesignParameter
from .mirror import Mirror
from .options import ObjectiveOptions


class TimeStep(NamedTuple):
    """The result of one control step of N worlds."""

    observation: Tensor  # (N, O) what the policy acts on next, after any reset
    reward: Tensor  # (N, m) one column per objective
    terminated: Tensor  # (N,) bool: the episode failed, its future is worth nothing
    truncated: Tensor  # (N,) bool: time ran out, its future still has value
    final_observation: Tensor  # (N, O) the observation before any reset
    terms: dict[str, Tensor]  # (N,) each: the unweighted reward terms
    critic_observation: Tensor  # (N, O + P) the observation, then the privileged features
    final_critic_observation: Tensor  # (N, O + P) the same before any reset
    blown_up: Tensor | None = None  # (N,) bool: terminated outside sane bounds; None: unknown


class Worlds(ABC):
    """N worlds of one task with several objectives, stepped together.

    `options` combine reward terms into objectives. A world whose episode ends is reset within the
    same step if `auto_reset`. No gradient passes through a step.
    """

    Options: ClassVar[type[ObjectiveOptions]]
    resumable: ClassVar[bool] = False  # `state_dict` holds everything that the future depends on
    recordable: bool = False  # on CUDA, `step` can be recorded in a CUDA graph
    needs_gpu: ClassVar[bool] = False  # many worlds on a CPU take hours
    shows_endings: ClassVar[bool] = True  # `final_observation` is what an episode ended with
    may_recover: ClassVar[bool] = True  # without `auto_reset`, a failed world goes on
    simulator: str  # name of the simulator
    options: ObjectiveOptions
    episode_length: int
    follows_part: bool = False  # episodes are parts of a motion, and start anywhere in it
    dt: float = math.inf  # seconds of a control step; infinite: unknown
    observation_size: int
    privileged_size: int = 0  # P, the number of features that only critics see
    action_size: int
    reward_terms: tuple[str, ...]
    objectives: tuple[str, ...]
    reference_point: tuple[float, ...]
    quantities: tuple[str, ...] = ()  # with units, that evaluations measure beside returns
    designs: ClassVar[dict[str, DesignParameter]] = {}  # parameters of the robot's body, by name
    lower_is_better: tuple[str, ...] = ()  # those of the quantities that policies should keep low
    # what people read instead of an objective's name: what there is more of when it is better
    titles: ClassVar[dict[str, str]] = {"energy": "energy saved", "effort": "effort saved"}
    paper_reset_terms: ClassVar[dict[str, float]] = {}  # for `paper_reset_reward`
    moved_by: Any = None  # weak reference to the learner that moved these worlds last
    _weights: Tensor  # (terms, m)

    def __init__(
        self, options: Any, num_worlds: int, device: torch.device, seed: int, auto_reset: bool
    ):
        self.options, self.num_worlds, self.device = options, num_worlds, device
        self.auto_reset, self.episode_length = auto_reset, options.episode_length
        # of every random draw while stepping
        self.generator = torch.Generator(device).manual_seed(seed)
        # (N,) control steps of each episode; () how often a world left sane bounds
        self.age = torch.zeros(num_worlds, dtype=torch.int32, device=device)
        self.blowups = torch.zeros((), dtype=torch.int64, device=device)

    def __init_subclass__(cls, **named: Any) -> None:
        super().__init_subclass__(**named)
        if "step" in vars(cls):
            step = cls.step

            @wraps(step)
            @torch.no_grad()  # worlds would keep the graph of the actions for ever
            def stepped(self: Any, action: Tensor) -> TimeStep:
                checks.action(self, action)
                result = step(self, action.detach())
                if type(self).step is stepped:  # a class above may go on with the result
                    checks.time_step(self, result)
                return result

            cls.step = stepped

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        raise MorlaxError(
            "worlds cannot be copied or pickled: make others with envs.make and the same seed, and "
            "give them the state of these with load_state_dict(worlds.state_dict())."
        )

    @classmethod
    def build(
        cls,
        options: Any,
        num_worlds: int,
        device: torch.device,
        backend: str | None,
        seed: int,
        *,
        auto_reset: bool,
        deterministic: bool,
    ) -> Self:
        """Build N worlds; `envs.make` calls this with validated `options` of class `Options`.

        By default, they have one simulator, of their own.
        """
        if backend is not None or deterministic:
            wish = "--deterministic" if deterministic else f"--backend {backend}"
            raise MorlaxError(
                f"these worlds have a simulator of their own, {cls.simulator}: leave {wish} out."
            )
        return cls(options, num_worlds, device, seed, auto_reset)

    def reset(self) -> Tensor:
        """Start a new episode in every world; returns the observation (N, O)."""
        self.restart(torch.ones(self.num_worlds, dtype=torch.bool, device=self.device))
        if self.auto_reset and self.options.stagger:  # first episodes only
            self.age.random_(0, self.episode_length, generator=self.generator)
        return self._policy(checks.seen(self, self.critic_observation()))

    @abstractmethod
    def restart(self, which: Tensor) -> Tensor:
        """Start a new episode in the worlds of a mask (N,) bool; returns the observation (N, O)."""

    @abstractmethod
    def step(self, action: Tensor) -> TimeStep:
        """Advance every world by one control step under `action` (N, A) in [-1, 1].

        Raises:
            MorlaxError: the action has another shape, type or device.
        """

    def move_only(self, which: Tensor) -> None:
        """From now on, step only the worlds of a mask (N,) bool, if that saves time.

        The others may stay as they are, and their rewards mean nothing.
        """
        assert which.shape == (self.num_worlds,)

    @abstractmethod
    def critic_observation(self) -> Tensor:
        """Return the current observation followed by the privileged features, (N, O + P)."""

    @property
    def interrupted(self) -> bool:
        """Whether others moved these worlds since their last step, so that `reset` comes next."""
        return False

    def measure(self) -> Tensor:
        """Return numbers of the last step (N, S), for `quantify`."""
        return torch.zeros(self.num_worlds, 0, dtype=torch.float32, device=self.device)

    def quantify(self, means: np.ndarray, falls: np.ndarray) -> np.ndarray:
        """Compute the `quantities` (K, q) from means of `measure` (K, S) over whole episodes.

        `falls` (K,) are failed episodes per step. By default, quantities are those means.
        """
        return means

    def mirror(self, tolerance: float = 0.0) -> Mirror:
        """Return how observations and actions change if left and right are exchanged.

        Left and right may differ by a tolerance, see `network.symmetry_tolerance`.
        """
        raise MorlaxError(
            "network.symmetric needs worlds that know left from right, and these do not: set it to "
            "false, or override `mirror` in the task."
        )

    def _policy(self, seen: Tensor) -> Tensor:
        """Return what policies see (N, O) of what critics see, (N, O + P)."""
        return seen[:, : self.observation_size]

    def overflow(self) -> Tensor:
        """Return (N,) int32, non-zero where the simulator's buffers overflowed."""
        return torch.zeros(self.num_worlds, dtype=torch.int32, device=self.device)

    def remedy(self, bits: int) -> str:
        """Say how to avoid the overflow with the union `bits` of `overflow`."""
        return ""

    def state_dict(self) -> dict[str, Any]:
        """Copy the state that the worlds' future depends on: all of it, if `resumable`."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a state of as many worlds, in place; with another seed, starts may differ."""
        assert not state, "these worlds have no state to restore"

    def reseed(self, seed: int) -> None:
        """Restart every random draw of future steps and resets from `seed`."""
        self.generator.manual_seed(seed)

    def share_draws(self, episodes: Tensor, number: int) -> None:
        """Let worlds of the same episode, of an index (N,), draw the same numbers from now on.

        An evaluation compares trade-offs under the same starts, models, commands and noise. Worlds
        whose library draws for all of them at once ignore it. `number`: of episodes to draw for, of
        which these worlds may run a part.
        """
        assert episodes.shape == (self.num_worlds,)

    def combine(self, terms: dict[str, Tensor]) -> Tensor:
        """Weight reward terms (N,) each into the reward of every objective (N, m)."""
        return self._combine(self._columns(terms))

    def _columns(self, terms: dict[str, Tensor]) -> Tensor:
        """Return terms (N,) by name, in any order, as (N, terms) in that of `reward_terms`."""
        if terms.keys() != {*self.reward_terms}:
            names, needed = ", ".join(terms), ", ".join(self.reward_terms)
            raise MorlaxError(f"the reward terms are {names}, but must be {needed} in each step.")
        return torch.stack([terms[name] for name in self.reward_terms], -1)

    def _combine(self, terms: Tensor) -> Tensor:
        """`combine` for terms (N, terms) in the order of `reward_terms`."""
        return (terms.unsqueeze(-1) * self._weights).sum(1)

    def define_objectives(self, dtype: torch.dtype = torch.float32) -> None:
        """Set `objectives`, `reference_point` and the reward weights, of the `dtype` of terms."""
        objectives, common = self.options.objectives, (self.options.shared, self.options.guide)
        for name in (name for group in (*common, *objectives.values()) for name in group):
            if name not in self.reward_terms:
                raise unknown("reward term", name, self.reward_terms)
        weights = [
            [sum(group.get(name, 0.0) for group in (*common, x)) for x in objectives.values()]
            for name in self.reward_terms
        ]
        self._weights = torch.tensor(weights, dtype=torch.float64).to(self.device, dtype)
        self.objectives = tuple(objectives)
        point = self.options.reference_point
        self.reference_point = (0.0,) * len(objectives) if point is None else point
        if len(self.reference_point) != len(objectives):
            raise MorlaxError(
                f"reference_point has {len(self.reference_point)} numbers, but there are "
                f"{len(objectives)} objectives: {', '.join(objectives)}."
            )

    def paper_reset_reward(self) -> Tensor:
        """Return the reward (m,) that the paper's evaluation protocol adds to every return."""
        rewards = [self.paper_reset_terms.get(name, 0.0) for name in self.reward_terms]
        terms = torch.tensor(rewards, dtype=torch.float32).to(self._weights)
        return self._combine(terms[None])[0].float()
