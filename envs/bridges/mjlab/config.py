"""The options of mjlab's tasks, and mjlab's config of a task as they change it."""

import contextlib
import io
import os
import warnings
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, PositiveFloat

from ...errors import MorlaxError, require, unknown, user_code
from ...naming import MJLAB
from ...worlds.options import Limits, ObjectiveOptions
from . import following
from .commands import VELOCITY
from .motion import files, joined, prepared
from .step import LEVELS

EFFORT = ("joint_torques_l2", "electrical_power_cost")  # mjlab's, for every robot
ALIVE = "is_alive"  # mjlab's, too: 1 unless the episode terminates

MotionFile = Annotated[str, AfterValidator(lambda name: name and str(Path(name).absolute()))]


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
    module, _, task = name.removeprefix(MJLAB).rpartition(":")
    if module:
        with user_code(f"{name} cannot import {module}"):
            import_module(module)
    registry = import_module("mjlab.tasks.registry")
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
    followers = [term for term in cfg.commands.values() if hasattr(term, "motion_file")]
    if options.motion_file and not followers:
        raise MorlaxError(f"{name} follows no motion: leave task.motion_file out.")
    for command in followers:
        command.motion_file = _motion(name, options, cfg, command)
    if not options.curriculum:
        cfg.curriculum = {}
        for action in cfg.actions.values():
            if hasattr(action, "curriculum"):
                action.curriculum = False
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
