"""Bridge to mjlab: N worlds of any of its tasks, with its reward terms by name."""

import contextlib
import io
import os
import warnings
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import torch
from pydantic import AfterValidator, Field, PositiveFloat
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from ...devices import drawing_from, global_generator
from ...errors import MorlaxError, require, unknown
from ...physics import compiling
from ...worlds.mirror import Mirror
from ...worlds.options import Count, Limits, ObjectiveOptions, Objectives, Point
from ..foreign import ForeignWorlds, Outcome, imported
from . import following
from .commands import MOTION, VELOCITY
from .history import History, lengths
from .mirror import mirror_of
from .motion import files, joined, prepared
from .step import LEVELS, MaskedStep, supported
from .walking import LOWER_IS_BETTER, QUANTITIES, Walking

BLOWN_UP = "blown_up"  # mjlab's name of the termination
EFFORT = ("joint_torques_l2", "electrical_power_cost")  # mjlab's, for every robot
ALIVE = "is_alive"  # mjlab's, too: 1 unless the episode terminates

MotionFile = Annotated[str, AfterValidator(lambda name: name and str(Path(name).absolute()))]

_rehearsed: set[str] = set()


class MjlabOptions(ObjectiveOptions):
    """The options of every mjlab task. Reward terms keep mjlab's weight and time step."""

    training_only = {**ObjectiveOptions.training_only, "curriculum": False}

    action_scale: PositiveFloat = 1.0
    """Factor on actions in [-1, 1]: those of mjlab have no bounds."""
    commands: dict[str, Limits] = {}
    """Ranges of commands by term and name, such as twist.lin_vel_x: [-1, 1]."""
    motion_file: MotionFile = ""
    """Motion to follow, for tasks that need one: in mjlab's npz format, or a CSV file whose columns
    are the root's x y z, its quaternion x y z w, and the angles of all joints. A folder: all its
    motions."""
    motion_fps: PositiveFloat = 30.0
    """Frames per second of a CSV file."""
    motion_stand: Annotated[float, Field(ge=0, le=60)] = 2.0
    """Seconds for which a robot stands in the last frame of a motion, as a part of it."""
    sensors: Literal["all", "real"] = "all"
    """What actors observe: all terms, or those that sensors of a robot measure (docs/mjlab.md)."""
    history: dict[str, Annotated[int, Field(ge=0, le=100)]] = {}
    """How many of its last values actors observe of a term; 0: none. Names may be patterns, such as
    joint_*."""
    curriculum: bool = False
    """Make the task harder while training goes on, as mjlab does."""
    robust: bool = False
    """Let motors, masses and delays of actions differ, and push harder; for robots that walk."""
    stagger: bool = True


@cache
def from_task(name: str) -> type["MjlabWorlds"]:
    """Return the class of "mjlab:TASK", a task of mjlab's registry.

    "mjlab:MODULE:TASK" imports the module first, which registers the task. The default objectives
    are all rewards, and all costs. The reference point of costs is one per second.
    """
    cfg = load(name)
    weights = {term: value.weight for term, value in cfg.rewards.items() if value}
    gains = {term: 1.0 for term, weight in weights.items() if weight > 0}
    costs = {term: 1.0 for term, weight in weights.items() if weight < 0} or {EFFORT[0]: -1.0}
    seconds = cfg.episode_length_s
    steps = round(seconds / (cfg.sim.mujoco.timestep * cfg.decimation))

    class Options(MjlabOptions):
        objectives: Objectives = {"rewards": gains, "costs": costs}
        reference_point: Point = (0.0, -float(seconds))
        episode_length: Count = steps

    return type("MjlabWorlds", (MjlabWorlds,), {"Options": Options, "name": name})


class MjlabWorlds(ForeignWorlds):
    """N worlds of a task of mjlab, on MuJoCo Warp; `from_task` makes such classes.

    Policies see mjlab's group of observations "actor", critics also its group "critic". A reward
    term is what mjlab adds to its own reward: with its weight and its time step. mjlab draws from
    torch's global generators, which here have their own state for these worlds.

    A recordable step restarts worlds itself. Their last observation is made where mjlab computes
    rewards: velocities and tilt of bodies are one physics step old, rays and commands one control
    step. mjlab's own step is followed by a second call that restarts worlds, and nothing is old.
    """

    Options: ClassVar[type[MjlabOptions]]
    options: MjlabOptions
    simulator = "mjlab"
    needs_gpu = True
    restarts = True  # in the step that ends an episode, whether or not a caller restarts them

    def _open(self, seed: int) -> None:
        cfg = changed(self.name, self.options, self.num_worlds, seed)
        masked = supported(cfg)
        if not masked and len(files(self.options.motion_file)) > 1:
            raise MorlaxError(
                f"{self.name} can follow one motion, not a folder of them, because its terms need "
                "mjlab's own step."
            )
        self.recordable = masked and self.device.type == "cuda"
        self._sharing: contextlib.AbstractContextManager[Any] = contextlib.nullcontext()
        if self.recordable:  # a recording draws from no other generator than torch's own
            self.generator = global_generator(self.device).manual_seed(seed)
        with drawing_from(self.generator):
            self.env = build(self.name, partial(self.config, seed), self.device)
            groups, _ = self.env.reset()
        self.reward_terms = tuple(self.env.reward_manager.active_terms)
        self.dt, self.age = self.env.step_dt, self.env.episode_length_buf
        self._time_step = self.dt if self.env.cfg.scale_rewards_by_dt else 1.0
        self._size(groups)
        self._remember()
        self.action_size = self.env.action_manager.total_action_dim
        manager = self.env.command_manager
        terms = {type(term).__name__: term for term in map(manager.get_term, manager.active_terms)}
        self._measures: Any = None
        if VELOCITY in terms:
            self._measures = Walking(self.env, terms[VELOCITY])
            self.quantities, self.lower_is_better = QUANTITIES, LOWER_IS_BETTER
        elif MOTION in terms and following.end_effectors(self.env.cfg):
            self._measures = following.Following(self.env, terms[MOTION])
            self.follows_part = self.episode_length < terms[MOTION].motion.time_step_total - 1
            self.quantities = self.lower_is_better = following.QUANTITIES
        self._step = MaskedStep(self.env, self.groups, self.restarts) if masked else None

    def _remember(self) -> None:
        manager, (actor, *_) = self.env.observation_manager, self.groups
        dims = zip(manager.active_terms[actor], manager.group_obs_term_dim[actor], strict=True)
        self.sizes = {name: torch.Size(dim).numel() for name, dim in dims}  # of each term's value
        self.lengths = lengths(self.sizes, self.options.sensors, self.options.history)
        parts = [*self.sizes.values(), self.privileged_size], [*self.lengths.values(), 1]
        self._history = History(*parts, self.num_worlds, self.device)
        self.observation_size = self._history.size - self.privileged_size

    def config(self, seed: int) -> Any:
        """Return mjlab's config of these worlds."""
        cfg = changed(self.name, self.options, self.num_worlds, seed)
        cfg.auto_reset = False  # `_restart` does it
        termination = import_module("mjlab.managers").TerminationTermCfg
        cfg.terminations[BLOWN_UP] = termination(func=_not_finite)
        return cfg

    def share_draws(self, episodes: Tensor, number: int) -> None:
        super().share_draws(episodes, number)
        if isinstance(self._measures, following.Following):
            self._measures.start(episodes, self.episode_length)
        elif self._step is None:
            return  # mjlab draws for some worlds at a time
        self._sharing = SharedDraws(episodes.to(self.device))
        with drawing_from(self.generator), self._sharing:
            if "startup" in self.env.event_manager.available_modes:
                self.env.event_manager.apply(mode="startup")

    def measure(self) -> Tensor:
        return self._measures.measure()

    def quantify(self, means: np.ndarray, falls: np.ndarray) -> np.ndarray:
        return self._measures.quantify(means, falls)

    def mirror(self, tolerance: float = 0.0) -> Mirror:
        return mirror_of(self.env, self.groups, tolerance, self.lengths)

    def _restart(self, which: Tensor, seen: Tensor) -> Tensor:
        worlds = which.nonzero().squeeze(1)  # waits for the GPU
        if not len(worlds):
            return seen
        with drawing_from(self.generator), self._sharing:
            groups, _ = self.env.reset(env_ids=worlds)
        if self._step is not None:
            self._step.settle()
        return torch.where(which[:, None], self._history.restart(which, self._joined(groups)), seen)

    def _advance(self, action: Tensor) -> Outcome:
        env, scaled = self.env, action.clamp(-1, 1) * self.options.action_scale
        if isinstance(self._measures, following.Following):
            self._measures.look()
        with drawing_from(self.generator), self._sharing:
            if self._step is not None:
                groups, before, failed, timed_out = self._step(scaled)
            else:
                groups, _, failed, timed_out, _ = env.step(scaled)
                before, failed = groups, failed.clone()
        if env.cfg.is_finite_horizon:
            failed, timed_out = failed | timed_out, torch.zeros_like(timed_out)
        timed_out, over = timed_out & ~failed, failed | timed_out
        values = self._joined(groups)
        restarted = over if self._step is not None and self.restarts else torch.zeros_like(over)
        last = torch.where(restarted[:, None], self._joined(before), values)
        final, seen = self._history.after(last), self._history.append(values, restarted)
        if self._step is None:
            seen = self._restart(over, seen)  # mjlab steps no world whose episode is over
        terms = env.reward_manager._step_reward * self._time_step
        blown_up = env.termination_manager.get_term(BLOWN_UP).clone()
        return Outcome(seen, final, terms, failed, timed_out, blown_up)


class SharedDraws(TorchDispatchMode):
    """Lets worlds of the same of `episodes` (N,) draw alike, wherever N rows are drawn at once."""

    def __init__(self, episodes: Tensor):
        super().__init__()
        self.number, self.source = len(episodes), episodes % len(episodes)

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        drawn = func(*args, **(kwargs or {}))
        if torch.Tag.nondeterministic_seeded not in func.tags or drawn.shape[:1] != (self.number,):
            return drawn
        shared = drawn[self.source]
        return drawn.copy_(shared) if func._schema.is_mutable else shared


def build(name: str, config: Callable[[], Any], device: torch.device) -> Any:
    """Return mjlab's environment of a new config, with most kernels compiled in parallel."""
    # tables of all terms; contacts with uneven ground that have only one point
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
        if name not in _rehearsed:
            _rehearsed.add(name)
            compiling.start(partial(step_physics, config(), str(device)))
            compiling.finish()
        return import_module("mjlab.envs").ManagerBasedRlEnv(config(), device=str(device))


def step_physics(config: Any, device: str) -> None:
    """Step and reset one world, as mjlab's `Simulation` does, without anything of torch.

    On a GPU, torch could stop the process at an index that no kernel has written.
    """
    import mujoco_warp as mjw
    import warp as wp

    config.scene.num_envs = 1
    model = import_module("mjlab.scene").Scene(config.scene, device=device).compile()
    config.sim.mujoco.apply(model)
    with wp.ScopedDevice(device):
        physics = mjw.put_model(model)
        config.sim.apply_wp_opt(physics.opt)
        size = {"nconmax": config.sim.nconmax, "njmax": config.sim.njmax}
        data = mjw.make_data(model, nworld=1, **size)
        mjw.step(physics, data)
        mjw.forward(physics, data)
        mjw.reset_data(physics, data, reset=wp.zeros(1, dtype=bool))
        wp.synchronize_device()  # Warp frees the spare data on another stream


def _not_finite(env: Any) -> Tensor:
    broken: Tensor = import_module("mjlab.envs.mdp").nan_detection(env)
    return broken | ~env.action_manager.action.isfinite().all(1)


def load(name: str) -> Any:
    """Return a copy of mjlab's config of "mjlab:TASK" or "mjlab:MODULE:TASK"."""
    os.environ.setdefault("MJLAB_WARP_QUIET", "1")
    advice = ", in a virtual environment of its own, because it replaces MuJoCo 4 by 3.11"
    require("mjlab", "mjlab", "1.6", "mjlab", advice)
    import warp as wp

    # its libraries print banners and use what torch deprecates
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
        import_module("mjlab.tasks")
        import_module(".tour", __package__)  # registers ours
    wp.config.log_level = wp.LOG_WARNING  # mjlab lets Warp report every kernel
    registry, task = import_module("mjlab.tasks.registry"), imported(name)
    if task not in registry.list_tasks():
        raise unknown("task of mjlab", task, registry.list_tasks())
    return registry.load_env_cfg(task)


def changed(name: str, options: MjlabOptions, num_worlds: int, seed: int) -> Any:
    """Return the config of `num_worlds` worlds under `options`.

    Only reward terms that an objective uses are kept. One of weight zero gets weight one.
    """
    cfg = load(name)
    add_terms(cfg)
    following.add_terms(cfg)
    groups = [options.shared, options.guide, *options.objectives.values()]
    used = [term for group in groups for term in group]
    terms = {term: value for term, value in cfg.rewards.items() if value is not None}
    for term in used:
        if term not in terms:
            raise unknown("reward term", term, terms)
    cfg.rewards = {term: value for term, value in terms.items() if term in used}
    for term in cfg.rewards.values():
        term.weight = term.weight or 1.0
    for path, limits in options.commands.items():
        _set_range(cfg, path, limits)
    for command in cfg.commands.values():
        if hasattr(command, "motion_file"):
            command.motion_file = _motion(name, options, cfg, command)
    if not options.curriculum:
        cfg.curriculum = {}
    _ready_terrain(cfg)
    if options.robust:
        if not any(type(command).__name__ == f"{VELOCITY}Cfg" for command in cfg.commands.values()):
            raise MorlaxError(f"{name} has no command of velocity: leave task.robust out.")
        import_module(".robust", __package__).harden(cfg)
    cfg.scene.num_envs, cfg.seed = num_worlds, seed % 2**31
    # half a step less: mjlab rounds up, and 7 * 0.02 s / 0.02 s are more than 7
    steps = options.episode_length - 0.5
    cfg.episode_length_s = steps * cfg.sim.mujoco.timestep * cfg.decimation
    return cfg


def _ready_terrain(cfg: Any) -> None:
    """Let robots on rough ground go from level to level, or start anywhere, as in mjlab's play."""
    if getattr(cfg.scene.terrain, "terrain_type", None) != "generator":
        return
    # mjlab's faster commands come only after 120,000 control steps, and cannot be recorded
    levels = {key: term for key, term in cfg.curriculum.items() if term.func.__name__ == LEVELS}
    cfg.curriculum = levels or cfg.curriculum
    if not cfg.curriculum:
        anywhere = import_module("mjlab.envs.mdp").randomize_terrain
        event = import_module("mjlab.managers").EventTermCfg(mode="reset", func=anywhere)
        cfg.events = {"randomize_terrain": event, **cfg.events}


def _motion(name: str, options: MjlabOptions, cfg: Any, command: Any) -> str:
    """Return the file of the motion that a command of mjlab follows, in mjlab's format."""
    if not (paths := files(options.motion_file or command.motion_file)):
        folder = Path(options.motion_file).is_dir()
        missing = f", and {options.motion_file} {'has none' if folder else 'is no file'}"
        raise MorlaxError(
            f"{name} follows a motion{options.motion_file and missing}: name its file with "
            "--task.motion-file FILE.npz, or FILE.csv, when you train, and keep it there."
        )
    rate = 1 / (cfg.sim.mujoco.timestep * cfg.decimation)
    robot = cfg.scene.entities[command.entity_name].spec_fn
    ready = []
    for file in paths:
        time, fps, stand = file.stat().st_mtime_ns, options.motion_fps, options.motion_stand
        motion, frames = prepared(file, time, fps, stand, rate, robot)
        if frames <= options.episode_length:
            raise MorlaxError(
                f"{file} lasts {frames} control steps, and an episode {options.episode_length}: "
                f"set --task.episode-length {frames - 1}, or less."
            )
        ready.append(motion)
    return str(ready[0] if len(ready) == 1 else joined(*ready))


def add_terms(cfg: Any) -> None:
    """Offer mjlab's terms of effort, of the first robot, and of survival to a task without them."""
    functions = import_module("mjlab.envs.mdp")
    managers = import_module("mjlab.managers")
    robot = managers.SceneEntityCfg(next(iter(cfg.scene.entities)), joint_names=(".*",))
    for term, params in (*((term, {"asset_cfg": robot}) for term in EFFORT), (ALIVE, {})):
        if term not in cfg.rewards:
            function = getattr(functions, term)
            cfg.rewards[term] = managers.RewardTermCfg(func=function, weight=0.0, params=params)


def _set_range(cfg: Any, path: str, limits: tuple[float, float]) -> None:
    term, _, name = path.partition(".")
    if term not in cfg.commands:
        raise unknown("command", term, cfg.commands)
    ranges = getattr(cfg.commands[term], "ranges", cfg.commands[term])
    if not isinstance(getattr(ranges, name, None), tuple):
        names = [key for key, value in vars(ranges).items() if isinstance(value, tuple)]
        raise unknown(f"range of the command {term}", name, names)
    setattr(ranges, name, limits)
