"""Playground's registry: a task's options, and its config with our changes."""

import importlib
import os
import warnings
from collections.abc import Iterable
from importlib import metadata
from typing import Any

from ..errors import MorlaxError, installation, shortened, unknown
from .foreign import imported
from .options import Count, ObjectiveOptions

EFFORT = "action_l2"  # our own reward term, beside those of the task
UNLIMITED = 1000  # steps per episode of a task without a limit of its own

Value = bool | int | float | str | list[float]


class PlaygroundOptions(ObjectiveOptions):
    """The options of every task of Playground."""

    overrides: dict[str, Value] = {}
    """Changes to the task's own config by key, such as reward_config.scales.energy: -0.01."""
    stagger: bool = True
    """Start first episodes at random ages, so that time limits do not coincide."""

    def for_evaluation(self) -> "PlaygroundOptions":
        return self.model_copy(update={"stagger": False})


def registry() -> Any:
    """Import Playground, and return its registry of tasks.

    Raises:
        MorlaxError: Playground is missing.
    """
    # by default, JAX takes three quarters of a GPU's memory, which torch needs too
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    try:
        metadata.version("playground")
    except metadata.PackageNotFoundError:
        raise MorlaxError(
            f"tasks of MuJoCo Playground need it: {installation('playground')}."
        ) from None
    import warp as wp

    with warnings.catch_warnings(action="ignore"):  # its libraries use what JAX deprecates
        found = importlib.import_module("mujoco_playground").registry
    wp.config.log_level = wp.LOG_WARNING  # MJX lets Warp report every kernel
    return found


def default_config(name: str) -> Any:
    """Return a copy of Playground's config of "playground:TASK" or "playground:MODULE:TASK".

    Raises:
        MorlaxError: Playground is missing, or it has no such task.
    """
    found = registry()
    task = imported(name)
    suites = (found.dm_control_suite, found.locomotion, found.manipulation)
    known = [task for suite in suites for task in suite.ALL_ENVS]
    if task not in known:
        raise unknown("task of MuJoCo Playground", task, known)
    return found.get_default_config(task)


def options_class(name: str) -> type[PlaygroundOptions]:
    """Return the options of a task with its defaults.

    The default objectives are the task's own reward, and the effort. The reference point of the
    effort is that of an episode under the largest actions.
    """
    steps = default_config(name).get("episode_length", UNLIMITED)

    class Options(PlaygroundOptions):
        objectives: dict[str, dict[str, float]] = {
            "reward": {"reward": 1.0},
            "effort": {EFFORT: -1.0},
        }
        reference_point: tuple[float, ...] | None = (0.0, -float(steps))
        episode_length: Count = steps

    return Options


def changed(name: str, overrides: dict[str, Any]) -> Any:
    """Return the config of a task with changes, by key.

    Raises:
        MorlaxError: the config has no such key, or it holds values of another type.
    """
    cfg = default_config(name)
    known = list(_keys(cfg))
    for key, value in overrides.items():
        if key not in known:
            raise unknown(f"key of the config of {name}", key, known)
        try:
            cfg.update_from_flattened_dict({key: value})
        except (TypeError, ValueError):
            kind = type(cfg[key]).__name__
            raise MorlaxError(f"{key} of {name} must be {kind}, not {shortened(value)}.") from None
    return cfg


def _keys(cfg: Any, above: str = "") -> Iterable[str]:
    for key, value in cfg.items():
        yield from _keys(value, f"{above}{key}.") if hasattr(value, "items") else (above + key,)
