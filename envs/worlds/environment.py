"""Base class of MuJoCo tasks: stepping, episode ends, automatic resets and rewards."""

import sys
from abc import abstractmethod
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import torch
from torch import Tensor

from ..devices import Draws, restore_generator
from ..errors import MorlaxError, user_code, warn_user
from ..physics.interface import Fields, Physics, explained
from ..physics.mujoco import MujocoPhysics
from . import checks, episodes, randomization
from .design_space import Bank, compiled
from .episodes import Starts, around
from .interface import TimeStep
from .mirror import PAIRS, Mirror, find_mirror
from .mujoco_robot import Part, Robot
from .options import Randomization, TaskOptions
from .randomization import Delay, Noise, Pushes

STARTS_OF_BODY = 16  # noisy initial states of each body, where bodies differ


class Environment(Robot):
    """N worlds of one MuJoCo robot with several objectives.

    A subclass defines the observation, the mapping from actions to control, named reward terms,
    failure and the initial state. `options` combine the terms into objectives. Derived quantities
    come from sensors, which lag one physics step behind `qpos` and `qvel`.

    A world whose episode ends is reset within the same step if `auto_reset`. A world whose action,
    state, observation or reward leaves sane bounds (see `episodes.end`) terminates with zero
    reward; the other worlds are unaffected.
    """

    Options: ClassVar[type[TaskOptions]]
    resumable = True
    recordable = True
    model_file: ClassVar[str]  # the MJCF, relative to the Python file that defines this attribute
    substeps: ClassVar[int] = 1  # physics steps per control step
    physics: Physics
    embodied: Tensor | None = None  # (N,) int64 rows of the adopted bank
    # The task's own tensors (N, ...) by name, from `initial_state`; `command` is one of them.
    state: dict[str, Tensor]

    def __init__(
        self, physics: Physics, options: TaskOptions, seed: int = 0, auto_reset: bool = True
    ):
        super().__init__(options, physics.num_worlds, physics.device, seed, auto_reset)
        self.physics, self.simulator = physics, physics.name
        self._episodes: Any = episodes
        if physics.device.type == "cuda":
            from . import episode_kernels  # one launch each, where torch takes a dozen

            self._episodes = episode_kernels
        self.dt = physics.model.opt.timestep * self.substeps
        self.draws, self._seed = Draws(self.generator, self.num_worlds), seed
        self.starts = self.prepare_starts(seed)
        self.action_size = self.count_actions()
        self._unsaved = checks.Unsaved(self)
        self.state = checks.state(self)
        self._initial = {name: value.clone() for name, value in self.state.items()}
        remembered = checks.by_name(self, "remember").items()
        self.memory = {name: value.clone() for name, value in remembered}
        self.observation_size = checks.rows(self, "observe", "O")
        self.privileged_size = checks.rows(self, "privileged", "P")
        checks.sizes(self)
        self._vary()
        chosen, draws = options.randomization, self.draws
        self._noise = self._delay = self._pushes = None
        if any(chosen.observation_noise.values()):
            self._noise = Noise(chosen.observation_noise, self.layout(), physics, draws)
        if any(chosen.action_delay):
            self._delay = Delay(chosen.action_delay, self.action_size, physics, draws)
        if chosen.push:
            self._pushes = Pushes(chosen.push, chosen.push_every, self.base, physics, draws)
        checks.control(self)
        checks.rewards(self)
        checks.answer(self, "reset")
        self.reward_terms = tuple(self.terms())
        self.define_objectives(physics.qpos.dtype)

    @classmethod
    def build(cls, options, num_worlds, device, backend, seed, *, auto_reset, deterministic):
        backend = backend or ("warp" if device.type == "cuda" else "mujoco")
        if backend == "mujoco" and device.type != "cpu":
            raise MorlaxError(f"C MuJoCo runs on the CPU: on {device}, use backend 'warp'.")
        model = cls.compile_model(options)
        if backend == "mujoco":
            physics = MujocoPhysics(model, num_worlds, cls.substeps)
        else:
            from ..physics.warp import WarpPhysics  # Warp takes seconds to import

            buffers = options.nconmax, options.njmax
            physics = WarpPhysics(model, num_worlds, device, cls.substeps, *buffers, deterministic)
        with explained("MuJoCo", (mujoco.FatalError,)):
            return cls(physics, options, seed, auto_reset)

    @classmethod
    def compile_model(cls, options: Any) -> mujoco.MjModel:
        """Return the model to simulate under `options`, of the class `Options`."""
        return cls.prepared(cls.model_for(options), options)

    @classmethod
    def prepared(cls, model: mujoco.MjModel, options: Any) -> mujoco.MjModel:
        """Return a compiled model with the solver's options, if a reset can restore its state."""
        if options.solver_iterations is not None:
            model.opt.iterations = options.solver_iterations
        checks.model(cls, model)
        return model

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        """Compile this robot's MJCF."""
        with user_code(f"MuJoCo cannot compile the MJCF of {cls.__name__}"):
            return cls.load_spec().compile()

    @classmethod
    def load_spec(cls) -> mujoco.MjSpec:
        """Read this robot's MJCF."""
        owner = next((base for base in cls.__mro__ if "model_file" in vars(base)), None)
        if owner is None:
            raise MorlaxError(f"{cls.__name__} names no MJCF: give it a model_file.")
        python_file = getattr(sys.modules[owner.__module__], "__file__", None) or ""
        path = Path(python_file).parent / cls.model_file
        with user_code(f"MuJoCo cannot load {path} of {cls.__name__}"):
            return mujoco.MjSpec.from_file(str(path))

    @classmethod
    def model_for(cls, options: Any) -> mujoco.MjModel:
        """Return the model of this robot under `options`, of the class `Options`."""
        home = {name: base for base in reversed(cls.__mro__) for name in vars(base)}
        unseen = home["load_model"] is not Environment and home["load_spec"] is Environment
        if cls.designs and unseen:
            raise MorlaxError(
                f"{cls.__name__} has designs, which change what load_spec returns: change the "
                "model there, not in load_model."
            )
        if cls.designs or options.design:
            return compiled(cls, options.design)[1]
        return checks.answer(cls, "load_model")

    @classmethod
    def shape(cls, spec: mujoco.MjSpec, design: dict[str, float]) -> None:
        """Give the robot of an MJCF the body of a design, in place, if there are `designs`.

        Raise its first body by as much as its legs become longer, so that it does not start in the
        floor. Numbers may change, but nothing may be added or removed.
        """
        raise NotImplementedError

    @abstractmethod
    def initial_qpos(self) -> np.ndarray:
        """Return the positions (nq,) that an episode starts from, at rest."""

    @abstractmethod
    def observe(self) -> Tensor:
        """Return the observation (N, O) from positions, velocities and sensors."""

    @abstractmethod
    def apply(self, action: Tensor) -> None:
        """Write an action (N, A) in [-1, 1] into `physics.ctrl`, in place."""

    @abstractmethod
    def terms(self) -> dict[str, Tensor]:
        """Return the unweighted reward terms (N,) of the last step, by name.

        `age` does not count this step yet: it is `episode_length - 1` in an episode's last step.
        """

    @abstractmethod
    def failed(self) -> Tensor:
        """Return (N,) bool: True where the robot has failed, which ends the episode."""

    def remember(self) -> dict[str, Tensor]:
        """Return values to compare with in the next step's terms; read them from `memory`."""
        return {}

    def initial_state(self) -> dict[str, Tensor]:
        """Return the task's own tensors (N, ...) by name, as episodes start with them.

        Read them from `state`, and change them in place. They are reset before `begin`, saved in
        checkpoints and restored. A `command` among them is `self.command`, too.
        """
        return {}

    def prepare_starts(self, seed: int) -> Starts:
        """Prepare the initial states: `initial_qpos` with the reset noise."""
        physics, noise = self.physics, self.options.reset_noise
        return Starts(around(checks.start(self), noise, physics.model, seed), physics)

    def vary_model(self, seed: int) -> Fields:
        """Draw the model fields (N, ...) that differ between worlds, by name, once for all.

        By default, these are the NumPy arrays that `task.randomization` asks for.
        Worlds that share draws need only the first `draws.number` rows.
        """
        options, model = self.options.randomization, self.physics.model
        return randomization.draw(model, options, self.draws.number, seed)

    def count_actions(self) -> int:
        """Return A, the size of an action."""
        return self.physics.model.nu

    def begin(self, fresh: Tensor) -> None:
        """Start episodes where `fresh` (N,) bool: draw goals, set activations and so on, in place.

        `state` has been reset before, and the physics to rows `starts.rows` of the starts.
        """

    def advance(self) -> None:
        """Update task state after the physics of a control step, before rewards."""

    def privileged(self) -> Tensor | None:
        """Return features (N, P) that only critics see while training; None: there are none.

        Policies never see them, so they may hold quantities that no robot could measure.
        """
        return None

    def layout(self) -> list[Part]:
        """Name the parts of the observation, in order; by default there is one part."""
        return [Part("observation", self.observation_size, "")]

    def share_draws(self, episodes: Tensor, number: int) -> None:
        self.draws.share(episodes, number)
        self._vary()

    def _vary(self) -> None:
        drawn, options = checks.fields(self, self._seed), self.options.randomization
        if lost := randomization.draw(self.physics.model, options, 1, 0).keys() - drawn:
            raise MorlaxError(
                f"{type(self).__name__}.vary_model() leaves out {', '.join(sorted(lost))}, which "
                "task.randomization changes: return them too, from super().vary_model(seed)."
            )
        drawn = {name: self.draws.of_worlds(values) for name, values in drawn.items()}
        self._model = {name: torch.from_numpy(values) for name, values in drawn.items()}
        if drawn:
            self.physics.vary(drawn)

    def adopt(self, bank: Bank) -> None:
        """Have the bodies of a bank, of which all worlds get the first; see `embody`."""
        if self._model:
            raise MorlaxError(
                "task.randomization cannot change friction, mass, strength or other fields of "
                "worlds whose bodies differ: leave it out, or set sampling.designs to 0."
            )
        physics, noise = self.physics, self.options.reset_noise
        physics.keep(bank.models)
        self.embodied = torch.zeros(self.num_worlds, dtype=torch.int64, device=self.device)
        starts = [
            start
            for qpos, model in zip(bank.starts, bank.models, strict=True)
            for start in around(qpos, noise, model, self._seed, STARTS_OF_BODY)
        ]
        self.starts = Starts(starts, physics, self.embodied)
        physics.choose(self.embodied)
        self.reset()

    def embody(self, rows: Tensor, fresh: Tensor) -> None:
        """Give worlds the bodies of rows (N,) of the bank, and restart the `fresh` ones, (N,) bool.

        Every world whose body changes must be fresh.
        """
        assert self.embodied is not None, "adopt a bank first"
        self.embodied.copy_(rows)
        self.physics.choose(self.embodied)
        self._restart(fresh)

    def reset(self) -> Tensor:
        super().reset()
        if self._noise:
            self._noise.draw()
        return self._policy(self.critic_observation())

    def restart(self, which: Tensor) -> Tensor:
        checks.mask(self, which)
        self._restart(which)
        return self._policy(self.critic_observation())

    def move_only(self, which: Tensor) -> None:
        self.physics.move_only(which)

    def step(self, action: Tensor) -> TimeStep:
        self.apply(self._delay(action) if self._delay else action)
        if self._pushes:
            self._pushes()
        self.physics.step()
        self.advance()
        if self._noise:  # once per step, so that both observations of a step have the same noise
            self._noise.draw()
        terms = self._columns(self.terms()).to(self._weights.dtype)  # (N, terms)
        reward = self._combine(terms).float()
        final_seen = self.critic_observation()
        failed, length = self.failed(), self.episode_length
        terminated, truncated, over, blown_up = self._episodes.end(
            self.physics, action, final_seen, failed, length, self.age, reward, terms, self.blowups
        )
        final_seen = final_seen.masked_fill(blown_up[:, None], 0.0)
        if self.auto_reset:
            self._restart(over)
            seen = self.critic_observation()
        else:
            self._remember()
            seen = final_seen
        by_name = dict(zip(self.reward_terms, terms.unbind(-1), strict=True))
        ends = terminated, truncated, self._policy(final_seen)
        return TimeStep(self._policy(seen), reward, *ends, by_name, seen, final_seen, blown_up)

    def critic_observation(self) -> Tensor:
        observation, privileged = self.observe(), self.privileged()
        if self._noise:
            observation = observation + self._noise.now
        if privileged is not None:
            observation = torch.cat([observation, privileged], -1)
        return observation.to(torch.float32, copy=True)  # it may be the simulator's own memory

    def _restart(self, over: Tensor) -> None:
        starts = self.starts.draw(self.draws)
        self._episodes.restart(self.physics, over, starts, self.age)
        for values, initial in self.physics.parts.values():
            episodes.refill(over, initial, values)
        for name, values in self.state.items():
            episodes.refill(over, self._initial[name], values)
        if self._delay:
            self._delay.begin(over)
        self.begin(over)
        self._remember()

    def _remember(self) -> None:
        for name, value in self.remember().items():
            self.memory[name].copy_(value)  # in place: a recorded step keeps its address

    def state_dict(self) -> dict[str, Any]:
        saved = self._state()
        self._unsaved.warn(saved.values())
        for name, (values, initial) in self.physics.parts.items():
            saved[name] = values.to(self.physics.qpos)  # in Warp, eq_active is boolean
            if torch.equal(values, initial.expand_as(values)):
                del saved[name]  # few robots change most parts
        tensors = {name: value.clone() for name, value in saved.items()}
        return {**tensors, "generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        # The state may come from the other simulator: what it lacks of the physics or of the task's
        # own tensors is reset.
        if new := [name for name in self.state if f"state.{name}" not in state]:
            warn_user(
                f"the saved worlds lack {', '.join(new)} of the task, which is reset instead."
            )
        values: dict[str, Any] = {name: start for name, (_, start) in self.physics.parts.items()}
        values |= {f"state.{name}": value for name, value in self._initial.items()}
        values |= state
        saved, memory = self._state(), {f"memory.{name}" for name in self.memory}
        if missing := saved.keys() - values - memory:
            raise MorlaxError(
                f"the saved worlds lack {', '.join(sorted(missing))}, which the options of this "
                "task need: resume with the config of the saved run."
            )
        for name in saved.keys() & state:
            if state[name].shape != saved[name].shape:
                shapes = f"{tuple(state[name].shape)} instead of {tuple(saved[name].shape)}"
                raise MorlaxError(
                    f"the saved worlds are another number or of another task: {name} is {shapes}."
                )
        for name in saved.keys() & values:
            saved[name].copy_(values[name])
        if self._model:
            self.physics.vary({name: value.numpy() for name, value in self._model.items()})
        if self.embodied is not None:
            self.physics.choose(self.embodied)
        if memory - values.keys():  # saved when the task remembered other things
            self._remember()
        restore_generator(self.generator, state["generator"])

    def _state(self) -> dict[str, Tensor]:
        names = "qpos", "qvel", "act", "ctrl", "warmstart", "sensors"
        saved = {name: getattr(self.physics, name) for name in names}
        saved |= {name: values for name, (values, _) in self.physics.parts.items()}
        saved |= {"age": self.age, "blowups": self.blowups}
        groups = {"memory": self.memory, "model": self._model, "state": self.state}
        for group, tensors in groups.items():
            saved |= {f"{group}.{name}": value for name, value in tensors.items()}
        for part in filter(None, (self._noise, self._delay)):
            saved |= part.state
        return saved if self.embodied is None else saved | {"embodied": self.embodied}

    def mirror(self, tolerance: float = 0.0) -> Mirror:
        """Return how observations and actions are mirrored, found by an experiment."""
        # A few of the models that a task may draw decide nothing: compare the nominal one.
        task = type(self)
        nominal: Any = type(task.__name__, (task,), {"vary_model": lambda env, seed: {}})
        changes = {"randomization": Randomization(), "stagger": False}
        options = self.options.model_copy(update=changes)
        physics = MujocoPhysics(self.compile_model(options), 2 * PAIRS, self.substeps)
        return find_mirror(nominal(physics, options, auto_reset=False), tolerance)

    def overflow(self) -> Tensor:
        return self.physics.overflow()

    def remedy(self, bits: int) -> str:
        return self.physics.remedy(bits)
