"""What a run's config refers to: code that must be trusted, and the robot's model.

A run's folder has copies of the files, so that it works on another computer. A fingerprint of the
model notices numbers that changed since training.
"""

import filecmp
import glob
import hashlib
import os
import shutil
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from .. import envs
from ..configuration.config import Config
from ..envs import Environment, MorlaxError, Worlds
from ..envs.errors import shortened, warn_user
from ..envs.naming import absolute, is_file, title
from ..host.files import attempting, make_folder, read, write_file

# fields of a config that may name a file or module, and a run's folder for a copy of it
NAMES_CODE = {"env": "task", "scalarization": "utility"}
MOST_BYTES = 20 * 2**20  # of the copies of a task; larger ones are not copied

_NAMED: dict[Path, str] = {}  # tasks of runs by folder, as a user has named them


def code_of(config: dict[str, Any]) -> list[str]:
    """Return the names in a config that may run code."""
    names = (config.get(field) for field in NAMES_CODE)
    return [name for name in names if isinstance(name, str)]


def name_task(folder: Path, task: str, env: str) -> None:
    """Let `env` be the `task` of the run in `folder`, and trust its code, in this process."""
    if not is_file(task) or not is_file(env) or title(env) != title(task):
        raise MorlaxError(
            f"{folder} is of the task {title(task)}, but --env (in Python env=...) is "
            f"{shortened(env)}: name FILE.py:{title(task)} if its file has moved, or leave out "
            "--env."
        )
    _NAMED[folder.resolve()] = absolute(env)
    envs.trust(env)


def named_task(folder: Path) -> str | None:
    return _NAMED.get(folder.resolve())


def copy_files(config: Config, folder: Path) -> None:
    """Copy the code that a config names, and its other files, into a run's folder."""
    from ..envs.external import parts_of

    for field, name in NAMES_CODE.items():
        code, copies = getattr(config, field), folder / name
        file = Path(code.rpartition(":")[0])
        if not is_file(code) or file.is_relative_to(folder.resolve()):
            continue
        copy, changed = compared(code, copies)
        if copy is not None and not changed:
            continue
        model = getattr(envs.get(code), "model_file", "") if field == "env" else ""
        parts = parts_of(file, model)
        with attempting(f"copy {file} and its models"):
            if sum(part.stat().st_size for part in parts) > MOST_BYTES:
                continue
            root = os.path.commonpath([part.parent for part in parts])
            shutil.rmtree(copies, ignore_errors=True)
            for part in parts:
                copy = copies / part.relative_to(root)
                make_folder(copy.parent)
                write_file(copy, read(part))


def compared(name: str, copies: Path) -> tuple[Path | None, list[Path]]:
    """Return the copy of FILE.py:CLASS's file, if any, and the files that differ from copies."""
    file = Path(name.rpartition(":")[0])
    candidates = copies.rglob(glob.escape(file.name))
    copy = min(candidates, key=lambda path: len(path.parts), default=None)
    if copy is None:
        return None, []
    root = file.parents[len(copy.relative_to(copies).parts) - 1]
    parts = [str(part.relative_to(copies)) for part in copies.rglob("*") if part.is_file()]
    _, changed, missing = filecmp.cmpfiles(root, copies, parts, shallow=False)
    return copy, [root / part for part in (*changed, *missing)]


def localized(values: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a config's plain values with the files of a run's folder, or those a user named."""
    values, requested = dict(values), named_task(folder)
    for field, copies in NAMES_CODE.items():
        name = values.get(field)
        if not isinstance(name, str) or not is_file(name) or ":" not in name:
            continue
        if field == "env" and requested is not None:
            values[field] = requested
            continue
        values[field] = name = absolute(name)
        copy, changed = compared(name, (folder / copies).resolve())
        if copy is None or not changed:
            continue
        file, _, member = name.rpartition(":")
        values[field] = f"{copy}:{member}"
        if os.path.isfile(file):
            wish = f"name {name} with --env" if field == "env" else "start a new run"
            warn_user(
                f"{changed[0]} is not as it was when the run began, so the run uses its own copy "
                f"in {(folder / copies).resolve()}: to use the edited one, {wish}."
            )
    return values


VERSION = "mujoco"  # key of MuJoCo's version, since each version may compile other numbers
# beginnings of the names of arrays that physics depends on, and parts of names of others
PHYSICAL = ("actuator", "body", "dof", "eq", "exclude", "flex", "geom", "hfield", "jnt", "key")
PHYSICAL += ("mesh_vert", "pair", "qpos", "sensor", "site", "tendon", "wrap")
OTHERS = ("rgba", "matid", "group", "user", "texcoord", "castshadow", "adr", "num", "bvh")
OPTIONS = ("timestep", "gravity", "wind", "density", "viscosity", "integrator", "cone", "impratio")
DIGITS = 2.0**20  # to which numbers are rounded, relative to their size, as machines differ
ZERO = 1e-9

_MODELS: WeakKeyDictionary[Worlds, dict[str, str]] = WeakKeyDictionary()  # fingerprints


def model_of(env: Worlds) -> dict[str, str]:
    """Return the fingerprint of the worlds' model, as it was compiled; empty if unknown."""
    if env not in _MODELS:
        # compiled anew, since a task may write into its model
        _MODELS[env] = model_of_task(type(env), env.options)
    return _MODELS[env]


def model_of_task(task: type[Worlds], options: Any) -> dict[str, str]:
    """Return a digest for each kind of part of a task's model; none if the model is unknown."""
    if not issubclass(task, Environment):
        return {}
    try:
        model = task.compile_model(options)
    except MorlaxError:  # which worlds of this task raise
        return {}
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


def check_model(
    stored: dict[str, str], current: dict[str, str], path: Path, warn: bool = True
) -> bool:
    """Return whether a checkpoint's model has changed, if both are known, and warn of it."""
    if not stored or stored.get(VERSION) != current.get(VERSION):
        return False
    kinds = [kind for kind in current if kind in stored and stored[kind] != current[kind]]
    if kinds and warn:
        warn_user(
            f"the robot's model is not the one that {path} was trained with (other numbers of: "
            f"{', '.join(kinds)}), so returns may differ."
        )
    return bool(kinds)
