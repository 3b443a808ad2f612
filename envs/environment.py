"""What every multi-objective task shares: stepping, episode ends, automatic reset, rewards."""

from abc import abstractmethod
from importlib import resources
from typing import Any, ClassVar

import mujoco
import numpy as np
import torch
from torch import Tensor

from . import episodes
from .errors import MorlaxError
from .layout import Part
from .options import TaskOptions
from .physics import Physics
from .starts import Starts
from .worlds import TimeStep, Worlds


class Environment(Worlds):
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
        self.simulator = physics.name
        self.episode_length = options.episode_length
        self.dt = physics.model.opt.timestep * self.substeps
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self.starts = Starts(self.initial_qpos(), options.reset_noise, physics, seed)
        self.age = torch.zeros(self.num_worlds, dtype=torch.int32, device=self.device)
        self.blowups = torch.zeros((), dtype=torch.int64, device=self.device)
        self._zero = torch.zeros((), device=self.device)  # where() would fill one each time
        self.memory = {name: value.clone() for name, value in self.remember().items()}
        self.action_size = physics.model.nu
        self.observation_size = self.reset().shape[1]
        self.privileged_size = self.critic_observation().shape[1] - self.observation_size
        self._check_layout()
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

    def privileged(self) -> Tensor | None:
        """(N, P) what critics see beside the observation while they train; None: nothing.

        No policy sees it, so it may be what no robot could measure.
        """
        return None

    def layout(self) -> list[Part]:
        """What the numbers of `observe` are, in order; of a task that does not say, one part."""
        return [Part("observation", self.observation_size, "")]

    def reset(self) -> Tensor:
        """Start every world anew; returns the observation (N, O)."""
        everywhere = torch.ones_like(self.age, dtype=torch.bool)
        self._restart(everywhere, everywhere)
        if self.options.stagger:
            self.age.random_(0, self.episode_length, generator=self.generator)
        return self.observe().float()

    def restart(self, which: Tensor) -> Tensor:
        """Start the worlds of a mask (N,) anew, and no other; returns the observation (N, O)."""
        self._restart(which, which)
        return self.observe().float()

    def step(self, action: Tensor) -> TimeStep:
        """Advance every world by one control step under `action` (N, A)."""
        self.apply(action)
        self.physics.step()
        terms = self.terms()
        reward = self.combine(terms).float()
        final_seen = self.critic_observation()
        terminated, truncated, blown_up = episodes.end(
            self.physics, self.failed(), self.episode_length, self.age, reward, self.blowups
        )
        final_seen = torch.where(blown_up[:, None], self._zero, final_seen)
        if self.auto_reset:
            self._restart(terminated, truncated)
            seen = self.critic_observation()
        else:
            self._remember()
            seen = final_seen
        observation, final_observation = (x[:, : self.observation_size] for x in (seen, final_seen))
        return TimeStep(
            observation, reward, terminated, truncated, final_observation, terms, seen, final_seen
        )

    def critic_observation(self) -> Tensor:
        observation, privileged = self.observe(), self.privileged()
        if privileged is not None:
            observation = torch.cat([observation, privileged], -1)
        return observation.float()

    def _restart(self, terminated: Tensor, truncated: Tensor) -> None:
        starts = self.starts.draw(self.generator)
        episodes.restart(self.physics, terminated, truncated, starts, self.age)
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
            **{f"memory.{name}": value for name, value in self.memory.items()},
        }

    def _check_layout(self) -> None:
        named = sum(part.size for part in self.layout())
        if named != self.observation_size:
            raise MorlaxError(
                f"{type(self).__name__}: layout() names {named} numbers, but observe() gives "
                f"{self.observation_size}: let both tell of the same ones."
            )

    def overflow(self) -> Tensor:
        return self.physics.overflow()

    def remedy(self, bits: int) -> str:
        return self.physics.remedy(bits)

    def paper_reset_reward(self) -> Tensor:
        terms = [self.paper_reset_terms.get(name, 0.0) for name in self.reward_terms]
        return (torch.tensor(terms).to(self._weights)[:, None] * self._weights).sum(0).float()
