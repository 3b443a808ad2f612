"""Descriptions of a task, its model and its front for the page."""

import json
import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..envs.worlds.mujoco_robot import Robot
from ..envs.worlds.trees import horizontal
from ..evaluation import pareto
from ..evaluation.evaluator import DISCOUNT, HORIZON
from ..evaluation.front import Front
from .camera import shown_geoms

MOST_DRAWN = 128  # policies of a front that is past
VELOCITIES = ("m/s", "lin_vel")  # how names of commanded velocities begin
SHAPES = (  # what the page draws; see mjModel
    *("geom_type", "geom_bodyid", "geom_group", "geom_matid", "geom_dataid"),
    *("geom_size", "geom_rgba", "geom_pos", "geom_quat", "geom_rbound", "mat_rgba"),
    *("hfield_size", "hfield_nrow", "hfield_ncol", "hfield_adr", "hfield_data"),
)
MESHES = {  # the rows of all meshes, and for each mesh its first row and how many it has
    "mesh_vert": ("mesh_vertadr", "mesh_vertnum"),
    "mesh_normal": ("mesh_normaladr", "mesh_normalnum"),
    "mesh_face": ("mesh_faceadr", "mesh_facenum"),
    "mesh_facenormal": ("mesh_faceadr", "mesh_facenum"),
}


def described_task(env: Robot) -> dict[str, Any]:
    names = list(env.command_limits)[:2]
    return {
        "dt": env.dt,
        "objectives": list(env.objectives),
        "titles": [env.titles.get(name, name) for name in env.objectives],
        "notes": [explain(env, name) for name in env.objectives],
        "command": {"limits": env.command_limits} if env.command_limits else None,
        # whether the command begins with velocities in m/s, forward and to the left
        "velocities": len(names) == 2 and all(name.startswith(VELOCITIES) for name in names),
        "followed": env.base,
        "pushed": horizontal(env.physics.model, env.base),
    }


def explain(env: Robot, objective: str) -> str:
    """Return an objective's weighted reward terms."""

    def weighted(terms: dict[str, float]) -> str:
        return " + ".join(f"{w:g} * {term}" for term, w in terms.items()).replace("+ -", "- ")

    note = f"{objective} = {weighted(env.options.objectives[objective])}."
    shared = env.options.shared
    return f"{note} Every objective also gets {weighted(shared)}." if shared else note


def front_map(front: Front, env: Robot) -> dict[str, Any]:
    """Describe a front as a map of policies.

    Divide `returns` by `seconds` for rewards per second of a full episode, weighted as in the
    returns. `measured` are the finite quantities, such as "power (W)"; their indices count the
    objectives first. `pair` are the axes to show first: quantities if there are two.
    """
    # of evaluations; the robot that is shown may follow a whole motion
    m, steps = len(front.objectives), env.options.episode_length
    if front.protocol == "discounted":  # sum of the steps' weights
        steps = (1 - DISCOUNT ** min(HORIZON, steps)) / (1 - DISCOUNT)
    finite = np.flatnonzero(np.isfinite(front.values).all(0))
    physical = finite[finite >= m]
    names = (*front.objectives, *front.quantity_names)
    low = np.array([name in env.lower_is_better for name in names])
    axes = physical if len(physical) > 1 else np.arange(m)
    signed = np.where(low, -front.values, front.values)[front.non_dominated][:, axes]

    def measured(i: int) -> dict[str, Any]:
        values = front.values[:, i].round(4).tolist()
        return {"index": i, "name": names[i], "lower": bool(low[i]), "values": values}

    return {
        "tradeoffs": front.tradeoffs.round(4).tolist(),
        "returns": front.returns.round(2).tolist(),
        "seconds": env.dt * steps,
        "measured": [measured(int(i)) for i in physical],
        "best": front.non_dominated.tolist(),
        "fails": front.fails.tolist(),
        "falls": front.falls.round(4).tolist(),
        "pair": axes[list(pareto.conflicting_pairs(signed)[0])].tolist(),
        "checkpoint": front.checkpoint,
        "fingerprint": front.fingerprint,
    }


@lru_cache(1000)
def moment_map(file: Path, *numbers: float) -> dict[str, Any]:
    """Describe one of `kept_fronts`: its numbers, and a few of its non-dominated policies."""
    front = Front.load(file)
    best = np.flatnonzero(front.non_dominated)
    shown = best[:: -(-len(best) // MOST_DRAWN)]
    values = front.values[shown].round(3).tolist()
    return {
        "numbers": numbers,
        "fingerprint": front.fingerprint,
        "tradeoffs": front.tradeoffs[shown].round(3).tolist(),
        # returns, then quantities, which need not be finite: JSON lacks such numbers
        "values": [[x if math.isfinite(x) else None for x in row] for row in values],
    }


def model_bytes(
    model: mujoco.MjModel, poses: Mapping[str, NDArray] | None = None, **numbers: float
) -> bytes:
    """Return a model, poses and numbers for the page's `arraysOf`: a JSON header, then arrays."""
    header, parts, at = {}, [], 0
    for name, values in {**_drawn(model), **(poses or {})}.items():
        kind = np.float32 if values.dtype.kind == "f" else np.int32
        data = np.ascontiguousarray(values, kind).tobytes()
        header[name] = [np.dtype(kind).name, at, values.size]
        parts.append(data)
        at += len(data)
    numbers |= {"nbody": model.nbody, "ngeom": model.ngeom}
    text = json.dumps({**numbers, "arrays": header}).encode()
    text += b" " * (-len(text) % 4)  # arrays begin at a multiple of their size
    return b"".join([np.int32(len(text)).tobytes(), text, *parts])


def _drawn(model: mujoco.MjModel) -> dict[str, NDArray]:
    """Return the arrays that the page draws a model from, without meshes that it does not show."""
    arrays = {name: getattr(model, name) for name in SHAPES}
    meshes = shown_geoms(model) & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    shown = np.isin(np.arange(model.nmesh), model.geom_dataid[meshes])
    for name, (first, number) in MESHES.items():
        counts = getattr(model, number)
        arrays[name] = getattr(model, name)[np.repeat(shown, counts)]
        counts = np.where(shown, counts, 0)
        arrays |= {first: np.cumsum(counts) - counts, number: counts}
    return arrays
