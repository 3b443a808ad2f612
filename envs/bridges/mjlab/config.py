"""Configs of mjlab's tasks, changed as our options say."""

import contextlib
import io
import os
import warnings
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, Self

from pydantic import PositiveFloat

from ...errors import MorlaxError, installation, unknown
from ...worlds.options import Count, ObjectiveOptions, Objectives, Point
from ..foreign import imported

OLDEST = 1, 6
EFFORT = ("joint_torques_l2", "electrical_power_cost")  # mjlab's, for every robot
ALIVE = "is_alive"  # mjlab's, too: 1 unless the episode terminates


class MjlabOptions(ObjectiveOptions):
    """The options of every mjlab task. Reward terms keep mjlab's weight and time step."""

    action_scale: PositiveFloat = 1.0
    """Factor on actions in [-1, 1]: those of mjlab have no bounds."""
    commands: dict[str, tuple[float, float]] = {}
    """Ranges of commands by term and name, such as twist.lin_vel_x: [-1, 1]."""
    motion_file: str = ""
    """Motion to follow, for tasks that need one."""
    curriculum: bool = False
    """Make the task harder while training goes on, as mjlab does."""
    stagger: bool = True
    """Start first episodes at random ages, so that time limits do not coincide."""

    def for_evaluation(self) -> Self:
        training_only = {"curriculum": False, "stagger": False}
        return super().for_evaluation().model_copy(update=training_only)


def load(name: str) -> Any:
    """Return a copy of mjlab's config of "mjlab:TASK" or "mjlab:MODULE:TASK"."""
    os.environ.setdefault("MJLAB_WARP_QUIET", "1")
    try:
        version = metadata.version("mjlab")
    except metadata.PackageNotFoundError:
        version = "0.0"
    if tuple(map(int, version.split(".")[:2])) < OLDEST:
        raise MorlaxError(
            "tasks of mjlab need mjlab 1.6 or newer, in a virtual environment of its own, because "
            f"it replaces MuJoCo 4 by 3.11: {installation('mjlab')}."
        )
    import warp as wp

    # its libraries print banners and use what torch deprecates
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
        import_module("mjlab.tasks")
    wp.config.log_level = wp.LOG_WARNING  # mjlab lets Warp report every kernel
    registry, task = import_module("mjlab.tasks.registry"), imported(name)
    if task not in registry.list_tasks():
        raise unknown("task of mjlab", task, registry.list_tasks())
    return registry.load_env_cfg(task)


def options_class(name: str) -> type[MjlabOptions]:
    """Return the options of a task with its defaults.

    The default objectives are all rewards, and all costs. The reference point of costs is one per
    second.
    """
    cfg = load(name)
    weights = {term: value.weight for term, value in cfg.rewards.items() if value}
    gains = {term: 1.0 for term, weight in weights.items() if weight > 0}
    costs = {term: 1.0 for term, weight in weights.items() if weight < 0}
    costs = costs or {EFFORT[0]: -1.0}
    seconds = cfg.episode_length_s
    steps = round(seconds / (cfg.sim.mujoco.timestep * cfg.decimation))

    class Options(MjlabOptions):
        objectives: Objectives = {"rewards": gains, "costs": costs}
        reference_point: Point = (0.0, -float(seconds))
        episode_length: Count = steps

    return Options


def changed(name: str, options: MjlabOptions, num_worlds: int, seed: int) -> Any:
    """Return the config of `num_worlds` worlds under `options`.

    Only reward terms that an objective uses are kept. One of weight zero gets weight one.
    """
    cfg = load(name)
    add_terms(cfg)
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
            command.motion_file = options.motion_file or command.motion_file
            if not Path(command.motion_file).is_file():
                raise MorlaxError(
                    f"{name} follows a motion: name its file with --task.motion-file FILE.npz."
                )
    if not options.curriculum:
        cfg.curriculum = {}
    cfg.scene.num_envs, cfg.seed = num_worlds, seed % 2**31
    cfg.episode_length_s = options.episode_length * cfg.sim.mujoco.timestep * cfg.decimation
    return cfg


def remembers(cfg: Any) -> bool:
    """Return whether an observation holds earlier or late ones, so that it is made only once."""
    return any(
        group.history_length
        or any(term.history_length or term.delay_max_lag for term in group.terms.values() if term)
        for group in cfg.observations.values()
        if group is not None
    )


def add_terms(cfg: Any) -> None:
    """Offer mjlab's terms of effort, of the first robot, and of survival to a task without them."""
    functions = import_module("mjlab.envs.mdp")
    managers = import_module("mjlab.managers")
    robot = managers.SceneEntityCfg(next(iter(cfg.scene.entities)), joint_names=(".*",))
    for term, params in (*((term, {"asset_cfg": robot}) for term in EFFORT), (ALIVE, {})):
        if term not in cfg.rewards:
            cfg.rewards[term] = managers.RewardTermCfg(
                func=getattr(functions, term), weight=0.0, params=params
            )


def _set_range(cfg: Any, path: str, limits: tuple[float, float]) -> None:
    term, _, name = path.partition(".")
    if term not in cfg.commands:
        raise unknown("command", term, cfg.commands)
    ranges = getattr(cfg.commands[term], "ranges", cfg.commands[term])
    if not isinstance(getattr(ranges, name, None), tuple):
        names = [key for key, value in vars(ranges).items() if isinstance(value, tuple)]
        raise unknown(f"range of the command {term}", name, names)
    setattr(ranges, name, limits)
