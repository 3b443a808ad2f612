"""What a page is sent of robots: their model once, and their poses in each frame."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import mujoco
import numpy as np

from ...envs.naming import title
from ..camera import followed_body
from ..explaining import explain, is_told_velocity
from ..front_map import front_map
from .behavior import Behavior
from .contacts import contact_arrows
from .session import Session

MODEL, FRAME = 0, 1  # first byte of a message that is not JSON
# what the page draws; see mjModel
SHAPES = (
    *("geom_type", "geom_bodyid", "geom_group", "geom_matid", "geom_dataid"),
    *("geom_size", "geom_rgba", "geom_pos", "geom_quat", "geom_rbound", "mat_rgba"),
    *("mesh_vertadr", "mesh_normaladr", "mesh_faceadr", "mesh_facenum"),
    *("mesh_vert", "mesh_normal", "mesh_face", "mesh_facenormal"),
    *("hfield_size", "hfield_nrow", "hfield_ncol", "hfield_adr", "hfield_data"),
)


def described(behavior: Behavior) -> dict[str, Any]:
    """Describe a robot, apart from its model and poses."""
    about: dict[str, Any] = {"dt": behavior.dt, "followed": followed_body(behavior.model)}
    if not isinstance(behavior, Session):
        return {"title": "A or B?", "objectives": [], "pushed": [], "command": None, **about}
    env = behavior.player.env
    return {
        "title": title(behavior.player.policy.config.env),
        "objectives": list(behavior.objectives),
        "notes": [explain(env, name) for name in behavior.objectives],
        "pushed": behavior.axes,
        "command": {"limits": env.command_limits} if env.command_limits else None,
        "velocities": is_told_velocity(env),
        "front": front_map(behavior.front, env.dt) if behavior.front is not None else None,
        **about,
    }


def told(behavior: Behavior) -> dict[str, Any]:
    """Describe a robot's trade-off and its episode."""
    if not isinstance(behavior, Session):
        return {}
    last = behavior.last_episode
    return {
        "tradeoff": behavior.tradeoff,
        "returns": _finite(behavior.player.returns.tolist()),
        "counted": behavior.steps,
        "ended": last and {**asdict(last), "returns": _finite(last.returns)},
        "velocity": _finite(behavior.velocity()),
        "power": _finite([behavior.power()])[0],
    }


def _finite(values: list[float]) -> list[float]:
    """Return numbers that JSON has."""
    return [value if math.isfinite(value) else 0.0 for value in values]


def model_bytes(model: mujoco.MjModel) -> bytes:
    """Return the arrays that the page draws a model from: a JSON header, then their bytes."""
    header: dict[str, Any] = {"nbody": model.nbody, "ngeom": model.ngeom, "arrays": {}}
    parts, at = [], 0
    for name in SHAPES:
        values = np.ascontiguousarray(getattr(model, name))
        kind = np.float32 if values.dtype.kind == "f" else np.int32
        data = values.astype(kind).tobytes()
        header["arrays"][name] = [np.dtype(kind).name, at, values.size]
        parts.append(data)
        at += len(data)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)  # arrays begin at a multiple of their size
    return b"".join([np.array([MODEL, len(text)], np.int32).tobytes(), text, *parts])


def frame_bytes(behaviors: Sequence[Behavior]) -> bytes | None:
    """Return steps, poses of bodies and forces at contacts of each robot, as 32-bit floats.

    None if a state is not finite, since nothing can be drawn then.
    """
    parts = [np.array([FRAME], np.int32).tobytes()]
    for behavior in behaviors:
        model, data = behavior.model, behavior.data
        if not np.isfinite(data.xpos).all():
            return None
        arrows = contact_arrows(model, data)
        numbers = ([behavior.steps, len(arrows)], data.xpos, data.xquat, arrows)
        parts += [np.asarray(part, np.float32).tobytes() for part in numbers]
    return b"".join(parts)
