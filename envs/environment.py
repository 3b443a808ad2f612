"""What every multi-objective task shares: stepping, episode ends, automatic reset, rewards."""

import sys
from abc import abstractmethod
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import torch
from torch import Tensor

from . import checks, episodes, variation
from .disturbances import Delay, Noise, Pushes
from .errors import MorlaxError
from .layout import Part
from .options import TaskOptions
from .physics import Physics
from .starts import Starts, around
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
    model_file: ClassVar[str]  # its MJCF, from the folder of the Python file that says so
    substeps: ClassVar[int] = 1  # physics steps per control step
    # What the paper's own evaluation adds to each return: these terms, for no step at all.
    paper_reset_terms: ClassVar[dict[str, float]] = {}
    # What the robot may be told while it moves: the limits of each number of `command` (N, C),
    # which anybody may write between steps.
    command_limits: ClassVar[dict[str, tuple[float, float]]] = {}
    command: Tensor

    def __init__(
        self, physics: Physics, options: TaskOptions, seed: int = 0, auto_reset: bool = True
    ):
        self.physics, self.options, self.auto_reset = physics, options, auto_reset
        self.num_worlds, self.device = physics.num_worlds, physics.device
        self.simulator = physics.name
        self.episode_length = options.episode_length
        self.dt = physics.model.opt.timestep * self.substeps
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self.starts = self.prepare_starts(seed)
        self.age = torch.zeros(self.num_worlds, dtype=torch.int32, device=self.device)
        self.blowups = torch.zeros((), dtype=torch.int64, device=self.device)
        self._zero = torch.zeros((), device=self.device)  # where() would fill one each time
        self.memory = {name: value.clone() for name, value in self.remember().items()}
        self.action_size = self.count_actions()
        self.observation_size = checks.rows(self, "observe", "O")
        self.privileged_size = checks.rows(self, "privileged", "P")
        checks.layout(self)
        self._randomize(seed)
        checks.control(self)
        checks.rewards(self)
        self.reset()
        self.reward_terms = tuple(self.terms())
        self.objectives = tuple(options.objectives)
        self.reference_point = self._reference_point()
        weights = torch.tensor(self._weighting(), dtype=torch.float64)
        self._weights = weights.to(physics.qpos)  # (terms, m)

    def _randomize(self, seed: int) -> None:
        chance, physics, generator = self.options.randomization, self.physics, self.generator
        drawn = self.vary_model(seed)
        self._model = {name: torch.from_numpy(values) for name, values in drawn.items()}
        self._noise = self._delay = self._pushes = None
        if drawn:
            physics.vary(drawn)
        if any(chance.observation_noise.values()):
            self._noise = Noise(chance.observation_noise, self.layout(), physics, generator)
        if any(chance.action_delay):
            self._delay = Delay(chance.action_delay, self.action_size, physics, generator)
        if chance.push:
            self._pushes = Pushes(chance.push, chance.push_every, physics, generator)

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        """This robot's compiled MJCF.

        Raises:
            MorlaxError: none is named, or MuJoCo cannot load it.
        """
        owner = next((base for base in cls.__mro__ if "model_file" in vars(base)), None)
        if owner is None:
            raise MorlaxError(f"{cls.__name__} names no MJCF: give it a model_file.")
        python_file = getattr(sys.modules[owner.__module__], "__file__", None) or ""
        path = Path(python_file).parent / cls.model_file
        try:
            return mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise MorlaxError(f"MuJoCo cannot load {path} of {cls.__name__}: {reason}") from None

    @classmethod
    def model_for(cls, options: Any) -> mujoco.MjModel:
        """The model of this robot that `options`, of the class `Options`, ask for."""
        return cls.load_model()

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
        return Starts(around(checks.start(self), noise, physics.model, seed), physics)

    def vary_model(self, seed: int) -> dict[str, np.ndarray]:
        """The fields (N, ...) of the model, by name, in which worlds differ; they keep them."""
        chance, model = self.options.randomization, self.physics.model
        return variation.draw(model, chance, self.num_worlds, seed)

    def count_actions(self) -> int:
        """A: how many numbers an action has."""
        return self.physics.model.nu

    def begin(self, fresh: Tensor) -> None:
        """Start what else a world has beside its physics, where `fresh` (N,) bool.

        The physics has been reset before, to rows `starts.rows` of the starts.
        """

    def advance(self) -> None:
        """Bring what else a world has up to date, after each physics step and before its terms."""

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
        self._restart(everywhere)
        if self.options.stagger:
            self.age.random_(0, self.episode_length, generator=self.generator)
        if self._noise:
            self._noise.draw()
        return self.critic_observation()[:, : self.observation_size]

    def restart(self, which: Tensor) -> Tensor:
        """Start the worlds of a mask (N,) anew, and no other; returns the observation (N, O)."""
        self._restart(which)
        return self.critic_observation()[:, : self.observation_size]

    def step(self, action: Tensor) -> TimeStep:
        """Advance every world by one control step under `action` (N, A)."""
        self.apply(self._delay(action) if self._delay else action)
        if self._pushes:
            self._pushes()
        self.physics.step()
        self.advance()
        if self._noise:
            self._noise.draw()
        terms = self.terms()
        reward = self.combine(terms).float()
        final_seen = self.critic_observation()
        terminated, truncated, over, blown_up = episodes.end(
            self.physics, self.failed(), self.episode_length, self.age, reward, self.blowups
        )
        final_seen = torch.where(blown_up[:, None], self._zero, final_seen)
        if self.auto_reset:
            self._restart(over)
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
        if self._noise:
            observation = observation + self._noise.now
        if privileged is not None:
            observation = torch.cat([observation, privileged], -1)
        return observation.float()

    def _restart(self, over: Tensor) -> None:
        starts = self.starts.draw(self.generator)
        episodes.restart(self.physics, over, starts, self.age)
        for leftover in self.physics.leftovers:
            leftover.masked_fill_(over[:, None, None], 0.0)
        if self._delay:
            self._delay.begin(over)
        self.begin(over)
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
        if self._model:
            self.physics.vary({name: value.numpy() for name, value in self._model.items()})
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
            **{f"leftover.{i}": value for i, value in enumerate(physics.leftovers)},
            **{f"memory.{name}": value for name, value in self.memory.items()},
            **{f"model.{name}": value for name, value in self._model.items()},
            **(self._noise.state if self._noise else {}),
            **(self._delay.state if self._delay else {}),
        }

    def overflow(self) -> Tensor:
        return self.physics.overflow()

    def remedy(self, bits: int) -> str:
        return self.physics.remedy(bits)

    def paper_reset_reward(self) -> Tensor:
        terms = [self.paper_reset_terms.get(name, 0.0) for name in self.reward_terms]
        return (torch.tensor(terms).to(self._weights)[:, None] * self._weights).sum(0).float()
