"""Descriptions of robots for a page: their model once, and their poses in each frame."""

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...envs.naming import title
from ...envs.worlds.trees import base_of
from ..describing import array_bytes, described_task, drawn_arrays, front_map
from .session import Behavior, Session

MODEL, FRAME = 0, 1  # first byte of a message that is not JSON
WEIGHT = 0.5  # length of an arrow that carries the robot's weight, in sizes of the robot


def described(behavior: Behavior) -> dict[str, Any]:
    """Describe a robot, apart from its model and poses."""
    if not isinstance(behavior, Session):
        robot = {"dt": behavior.dt, "followed": base_of(behavior.model)}
        return {"title": "A or B?", "objectives": [], "pushed": [], "command": None, **robot}
    env, front, policy = behavior.player.env, behavior.front, behavior.player.policy
    parameters = policy.agent.designs if behavior.design else {}
    return {
        "title": title(policy.config.env),
        "command": {"limits": env.command_limits} if env.command_limits else None,
        "design": {f"{k} ({x.unit})": [x.low, x.high] for k, x in parameters.items()} or None,
        "front": None if front is None else front_map(front, env.dt, env.lower_is_better),
        **described_task(env),
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
        "ended": last and {**last._asdict(), "returns": _finite(last.returns)},
        "velocity": _finite(behavior.velocity()),
        "power": _finite([behavior.power()])[0],
    }


def _finite(values: list[float]) -> list[float]:
    """Return numbers that JSON has."""
    return [value if math.isfinite(value) else 0.0 for value in values]


def model_bytes(model: mujoco.MjModel) -> bytes:
    """Return the arrays that the page draws a model from."""
    arrays = array_bytes(drawn_arrays(model), nbody=model.nbody, ngeom=model.ngeom)
    return np.int32(MODEL).tobytes() + arrays


def frame_bytes(behaviors: Sequence[Behavior]) -> bytes | None:
    """Return steps, poses of bodies and forces at contacts, as 32-bit floats; None: not finite."""
    parts = [np.array([FRAME], np.int32).tobytes()]
    for behavior in behaviors:
        model, data = behavior.model, behavior.data
        if not np.isfinite(data.xpos).all():
            return None
        arrows = contact_arrows(model, data)
        numbers = ([behavior.steps, len(arrows)], data.xpos, data.xquat, arrows)
        parts += [np.asarray(part, np.float32).tobytes() for part in numbers]
    return b"".join(parts)


def contact_arrows(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    """Return arrows (n, 2, 3) of the forces at each contact, as the ground pushes the robot.

    They are at most as long as the robot, because impacts are many times a weight.
    """
    size = float(model.stat.extent)
    newtons = float(model.body_subtreemass[0] * np.linalg.norm(model.opt.gravity))
    arrows, force = np.zeros((data.ncon, 2, 3)), np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        contact = data.contact[i]
        push = contact.frame.reshape(3, 3).T @ force[:3]
        push *= np.copysign(WEIGHT * size / max(newtons, 1e-9), push[2])
        push *= min(1.0, size / max(float(np.linalg.norm(push)), 1e-12))
        arrows[i] = contact.pos, contact.pos + push
    return arrows
