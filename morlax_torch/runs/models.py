"""Fingerprints of the MuJoCo models that runs were trained with, to notice a model that changed."""

import hashlib
import warnings
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from ..envs import Environment, MorlaxError, Worlds
from ..envs.errors import MorlaxWarning

VERSION = "mujoco"  # key of MuJoCo's version, since each version may compile other numbers
# beginnings of the names of arrays that physics depends on, and parts of names of others
PHYSICAL = ("actuator", "body", "dof", "eq", "exclude", "flex", "geom", "hfield", "jnt", "key")
PHYSICAL += ("mesh_vert", "pair", "qpos", "sensor", "site", "tendon", "wrap")
OTHERS = ("rgba", "matid", "group", "user", "texcoord", "castshadow", "adr", "num", "bvh")
OPTIONS = ("timestep", "gravity", "wind", "density", "viscosity", "integrator", "cone", "impratio")
DIGITS = 2.0**20  # to which numbers are rounded, relative to their size, as machines differ
ZERO = 1e-9

_OF_WORLDS: WeakKeyDictionary[Worlds, dict[str, str]] = WeakKeyDictionary()


def fingerprint(model: mujoco.MjModel) -> dict[str, str]:
    """Return a short text of each kind of part that physics depends on, equal if its numbers are.

    Names, files, colors and other looks do not count.
    """
    marks = {"option": _mark([getattr(model.opt, name) for name in OPTIONS])}
    for kind in PHYSICAL:
        names = [name for name in sorted(dir(model)) if name.startswith(kind)]
        arrays = [getattr(model, name) for name in names if not any(x in name for x in OTHERS)]
        marks[kind] = _mark([array for array in arrays if isinstance(array, np.ndarray)])
    return {VERSION: mujoco.__version__, **marks}


def _mark(arrays: list[np.ndarray | float]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        values = np.asarray(array, dtype=np.float64)
        mantissa, exponent = np.frexp(np.where(np.abs(values) < ZERO, 0.0, values))
        rounded = np.ldexp(np.round(mantissa * DIGITS), exponent) + 0.0
        digest.update(f"{rounded.shape}".encode() + rounded.tobytes())
    return digest.hexdigest()[:8]


def of_worlds(env: Worlds) -> dict[str, str]:
    """Return the fingerprint of the worlds' model, as it was compiled; empty if unknown."""
    if env not in _OF_WORLDS:
        # compiled anew, since a task may write into its model
        _OF_WORLDS[env] = of_task(type(env), env.options)
    return _OF_WORLDS[env]


def of_task(task: type[Worlds], options: Any) -> dict[str, str]:
    """Return the fingerprint of the model of a task under its options; empty if unknown."""
    if not issubclass(task, Environment):
        return {}
    try:
        return fingerprint(task.compile_model(options))
    except MorlaxError:  # which worlds of this task raise
        return {}


def difference(stored: dict[str, str], now: dict[str, str]) -> str:
    """Return the kinds of parts that differ, if both are known and of one MuJoCo version, or ""."""
    if not stored or stored.get(VERSION) != now.get(VERSION):
        return ""
    return ", ".join(kind for kind in now if kind in stored and stored[kind] != now[kind])


def warn(difference: str, path: Path) -> None:
    """Warn that a checkpoint's model has changed, if there is a `difference`."""
    if difference:
        warnings.warn(
            f"the robot's model is not the one that {path} was trained with (other numbers of: "
            f"{difference}), so returns may differ.",
            MorlaxWarning,
            stacklevel=2,
        )
