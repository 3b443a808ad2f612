"""What a page is sent of robots: their model once, and their poses in each frame."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import mujoco
import numpy as np

from ...envs.naming import title
from ...envs.worlds.trees import base_of
from ..arrays import array_bytes, drawn_arrays
from ..explaining import explain, is_told_velocity
from ..front_map import front_map
from .behavior import Behavior
from .contacts import contact_arrows
from .session import Session

MODEL, FRAME = 0, 1  # first byte of a message that is not JSON


def described(behavior: Behavior) -> dict[str, Any]:
    """Describe a robot, apart from its model and poses."""
    about: dict[str, Any] = {"dt": behavior.dt, "followed": base_of(behavior.model)}
    if not isinstance(behavior, Session):
        return {"title": "A or B?", "objectives": [], "pushed": [], "command": None, **about}
    env, front = behavior.player.env, behavior.front
    return {
        "title": title(behavior.player.policy.config.env),
        "objectives": list(behavior.objectives),
        "notes": [explain(env, name) for name in behavior.objectives],
        "pushed": behavior.axes,
        "command": {"limits": env.command_limits} if env.command_limits else None,
        "velocities": is_told_velocity(env),
        "design": _parameters(behavior),
        "front": None if front is None else front_map(front, env.dt, env.lower_is_better),
        **about,
        "followed": env.base,
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


def _parameters(session: Session) -> dict[str, Any] | None:
    """Describe the design parameters of a robot whose body can change."""
    if not session.design:
        return None
    parameters = session.player.policy.agent.designs.items()
    return {f"{name} ({each.unit})": [each.low, each.high] for name, each in parameters}


def _finite(values: list[float]) -> list[float]:
    """Return numbers that JSON has."""
    return [value if math.isfinite(value) else 0.0 for value in values]


def model_bytes(model: mujoco.MjModel) -> bytes:
    """Return the arrays that the page draws a model from."""
    arrays = array_bytes(drawn_arrays(model), nbody=model.nbody, ngeom=model.ngeom)
    return np.int32(MODEL).tobytes() + arrays


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
