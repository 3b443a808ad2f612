"""What every multi-objective task shares: stepping, episode ends, automatic reset, rewards."""

from abc import ABC, abstractmethod
from importlib import resources
from typing import Any, ClassVar, NamedTuple

import gymnasium
import mujoco
import numpy as np
import torch
from torch import Tensor

from . import episodes
from .errors import MorlaxError, unknown
from .options import TaskOptions
from .physics import Physics
from .starts import Starts, around


class TimeStep(NamedTuple):
    """What one control step of N worlds gave."""

    observation: Tensor  # (N, O) what the policy acts on next, after any reset
    reward: Tensor  # (N, m) a column for each objective
    terminated: Tensor  # (N,) bool: the episode failed, its future is worth nothing
    truncated: Tensor  # (N,) bool: time ran out, its future still has value
    final_observation: Tensor  # (N, O) what was seen before any reset
    terms: dict[str, Tensor]  # (N,) each: the reward terms, unweighted


class Environment(ABC):
    """N worlds of one robot with several objectives.

    A robot says what it observes, how an action becomes control, its named reward terms, when it
    has failed and where it starts. Terms are combined into objectives by `options`. Derived
    quantities come from sensors, which lag one physics step behind `qpos` and `qvel`.

    A world whose episode ends is reset within the same step (`auto_reset`). A world whose state
    is no longer finite is terminated with zero reward; no other world notices.
    """

    Options: ClassVar[type[TaskOptions]]
    model_file: ClassVar[str]
    substeps: ClassVar[int] = 1  # physics steps per control step
    # What the paper's own evaluation adds to each return: these terms, for no step at all.
    paper_reset_terms: ClassVar[dict[str, float]] = {}

    def __init__(
        self, physics: Physics, options: TaskOptions, seed: int = 0, auto_reset: bool = True
    ):
        self.physics, self.options, self.auto_reset = physics, options, auto_reset
        self.num_worlds, self.device = physics.num_worlds, physics.device
        self.episode_length = options.episode_length
        self.dt = physics.model.opt.timestep * self.substeps
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self.starts = self.prepare_starts(seed)
        self.age = torch.zeros(self.num_worlds, dtype=torch.int32, device=self.device)
        self.blowups = torch.zeros((), dtype=torch.int64, device=self.device)
        self._zero = torch.zeros((), device=self.device)  # where() would fill one each time
        self.memory = {name: value.clone() for name, value in self.remember().items()}
        self.action_size = self.count_actions()
        self.observation_size = self.reset().shape[1]
        self.reward_terms = tuple(self.terms())
        self.objectives = tuple(options.objectives)
        self.reference_point = self._reference_point()
        weights = torch.tensor(self._weighting(), dtype=torch.float64)
        self._weights = weights.to(physics.qpos)  # (terms, m)

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        """This robot's compiled MJCF."""
        assets = resources.files(str(__package__)) / "assets"
        with resources.as_file(assets / cls.model_file) as path:
            return mujoco.MjModel.from_xml_path(str(path))

    @classmethod
    def model_for(cls, options: Any) -> mujoco.MjModel:
        """The model of this robot that `options`, of the class `Options`, ask for."""
        return cls.load_model()

    @classmethod
    def varied_fields(cls, options: Any) -> tuple[str, ...]:
        """The fields of the model that each world is to have for itself, as `physics.varied`."""
        return ()

    @abstractmethod
    def initial_qpos(self) -> np.ndarray:
        """The positions (nq,) that an episode starts from, at rest."""

    @abstractmethod
    def observe(self) -> Tensor:
        """(N, O) from positions, velocities and sensors."""

    @abstractmethod
    def apply(self, action: Tensor) -> None:
        """Write an action (N, A) in [-1, 1] into `physics.ctrl`, in place."""

    @abstractmethod
    def terms(self) -> dict[str, Tensor]:
        """The unweighted reward terms (N,) of the step just made, by name."""

    @abstractmethod
    def failed(self) -> Tensor:
        """(N,) bool: worlds whose episode is over for good."""

    def remember(self) -> dict[str, Tensor]:
        """What the next step's terms compare with; it stands in `memory` until then."""
        return {}

    def prepare_starts(self, seed: int) -> Starts:
        """The states that episodes start from: `initial_qpos`, give or take the reset's noise."""
        physics, noise = self.physics, self.options.reset_noise
        return Starts(around(self.initial_qpos(), noise, physics.model, seed), physics)

    def count_actions(self) -> int:
        """A: how many numbers an action has."""
        return self.physics.model.nu

    def begin(self, fresh: Tensor) -> None:  # noqa: B027 - most robots have nothing more
        """Start what else a world has beside its physics, where `fresh` (N,) bool.

        The physics has been reset before, to rows `starts.rows` of the starts.
        """

    def advance(self) -> None:  # noqa: B027
        """Bring what else a world has up to date, after each physics step and before its terms."""

    def reset(self) -> Tensor:
        """Start every world anew; returns the observation (N, O)."""
        everywhere = torch.ones_like(self.age, dtype=torch.bool)
        self._restart(everywhere, everywhere)
        if self.options.stagger:
            self.age.random_(0, self.episode_length, generator=self.generator)
        return self.observe().float()

    def step(self, action: Tensor) -> TimeStep:
        """Advance every world by one control step under `action` (N, A)."""
        self.apply(action)
        self.physics.step()
        self.advance()
        terms = self.terms()
        reward = self.combine(terms).float()
        final_observation = self.observe().float()
        terminated, truncated, blown_up = episodes.end(
            self.physics, self.failed(), self.episode_length, self.age, reward, self.blowups
        )
        final_observation = torch.where(blown_up[:, None], self._zero, final_observation)
        if self.auto_reset:
            self._restart(terminated, truncated)
            observation = self.observe().float()
        else:
            self._remember()
            observation = final_observation
        return TimeStep(observation, reward, terminated, truncated, final_observation, terms)

    def combine(self, terms: dict[str, Tensor]) -> Tensor:
        """Reward terms (N,) each, to the reward of every objective (N, m)."""
        return (torch.stack(list(terms.values()), -1).unsqueeze(-1) * self._weights).sum(1)

    def _restart(self, terminated: Tensor, truncated: Tensor) -> None:
        starts = self.starts.draw(self.generator)
        episodes.restart(self.physics, terminated, truncated, starts, self.age)
        fresh = terminated | truncated
        for leftover in self.physics.leftovers:
            leftover.masked_fill_(fresh[:, None, None], 0.0)
        self.begin(fresh)
        self._remember()

    def _remember(self) -> None:
        for name, value in self.remember().items():
            self.memory[name].copy_(value)

    def state_dict(self) -> dict[str, Any]:
        """A copy of all that the worlds' future depends on."""
        tensors = {name: value.clone() for name, value in self._state().items()}
        return {**tensors, "generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go back to a state of the same number of worlds, in place."""
        for name, value in self._state().items():
            value.copy_(state[name])
        self.generator.set_state(state["generator"].cpu())

    def _state(self) -> dict[str, Tensor]:
        physics = self.physics
        return {
            "qpos": physics.qpos,
            "qvel": physics.qvel,
            "warmstart": physics.warmstart,
            "sensors": physics.sensors,
            "age": self.age,
            "blowups": self.blowups,
            **{f"model.{name}": value for name, value in physics.varied.items()},
            **{f"leftover.{i}": value for i, value in enumerate(physics.leftovers)},
            **{f"memory.{name}": value for name, value in self.memory.items()},
        }

    def _weighting(self) -> list[list[float]]:
        objectives, shared = self.options.objectives, self.options.shared
        for name in [*shared, *(name for group in objectives.values() for name in group)]:
            if name not in self.reward_terms:
                raise unknown("reward term", name, self.reward_terms)
        return [
            [shared.get(name, 0.0) + group.get(name, 0.0) for group in objectives.values()]
            for name in self.reward_terms
        ]

    def _reference_point(self) -> tuple[float, ...]:
        point = self.options.reference_point
        if point is None:
            return (0.0,) * len(self.objectives)
        if len(point) != len(self.objectives):
            raise MorlaxError(
                f"reference_point has {len(point)} numbers, but there are "
                f"{len(self.objectives)} objectives: {', '.join(self.objectives)}."
            )
        return point

    def paper_reset_reward(self) -> Tensor:
        """(m,) what the paper's evaluation protocol adds to every return."""
        terms = [self.paper_reset_terms.get(name, 0.0) for name in self.reward_terms]
        return (torch.tensor(terms).to(self._weights)[:, None] * self._weights).sum(0).float()

    @property
    def observation_space(self) -> gymnasium.spaces.Box:
        """What one world shows."""
        return gymnasium.spaces.Box(-np.inf, np.inf, (self.observation_size,), np.float32)

    @property
    def action_space(self) -> gymnasium.spaces.Box:
        """What one world takes."""
        return gymnasium.spaces.Box(-1.0, 1.0, (self.action_size,), np.float32)

    @property
    def reward_space(self) -> gymnasium.spaces.Box:
        """What one world pays, a number for each objective, in `objectives`' order."""
        return gymnasium.spaces.Box(-np.inf, np.inf, (len(self.objectives),), np.float32)
