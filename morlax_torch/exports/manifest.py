"""Metadata for running an exported policy on a robot, as plain values for JSON."""

import hashlib
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import mujoco
import torch

from .. import envs
from ..envs import Environment, Robot
from ..host.files import AnyPath
from ..host.version import __version__
from ..networks.policy import Policy
from ..runs.loading import find_checkpoint, find_run
from ..runs.progress import best_row, hypervolume_of, read_rows

STEP = 2**-6  # of an action, to measure the slope of its control; exact in binary


def robot_of(policy: Policy) -> Robot:
    """Make one robot of the policy's task."""
    config = policy.config
    robot = envs.make_robot(config.env, **config.task.for_evaluation().model_dump())
    policy.agent.check_sizes(robot)
    return robot


def manifest(
    policy: Policy, tradeoff: Sequence[float] | None = None, robot: Robot | None = None
) -> dict[str, Any]:
    """Return the task, the order and units of inputs and outputs, and the control rate.

    `robot` is the task's, if it is made already.
    """
    config, env = policy.config, robot or robot_of(policy)
    return {
        "morlax_torch": __version__,
        "task": config.env,
        "scalarization": config.scalarization,
        "objectives": list(policy.objectives),
        "tradeoff": None if tradeoff is None else [float(weight) for weight in tradeoff],
        "control_rate_hz": round(1 / env.dt, 6),
        "observation_size": env.observation_size,
        "observation": observation(env),
        "action_size": env.action_size,
        "actuators": actuators(env),
        "control": control(env),
    }


def provenance(run: AnyPath) -> dict[str, Any]:
    """Return the checkpoint's SHA-256, and the best hypervolume of its run if known."""
    checkpoint, metrics = find_checkpoint(run), find_run(run) / "metrics.csv"
    known: dict[str, Any] = {"sha256": hashlib.sha256(checkpoint.read_bytes()).hexdigest()}
    if metrics.is_file():
        rows = read_rows(metrics)
        known["best_hypervolume"] = hypervolume_of(rows[best_row(rows)])
    return known


def observation(env: Robot) -> list[dict[str, Any]]:
    """Return the name, slice and unit of each part of an observation."""
    parts = env.layout()
    stops = accumulate(part.size for part in parts)
    return [
        {"name": part.name, "slice": [stop - part.size, stop], "unit": part.unit}
        for part, stop in zip(parts, stops, strict=True)
    ]


def actuators(env: Robot) -> list[dict[str, Any]]:
    """Return joint, gear and control range of each actuator, in the order of actions.

    Gear and range are None where an action is not the control of one of the model's actuators.
    """
    targets = env.targets()
    if targets is not None:
        return [
            {"name": name, "joint": name, "gear": None, "control_range": None} for name in targets
        ]
    model, found = env.physics.model, []
    for index in range(model.nu):
        driven, limits = model.actuator_trnid[index, 0], model.actuator_ctrlrange[index]
        of_joint = model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_JOINT
        found.append(
            {
                "name": model.actuator(index).name,
                "joint": model.joint(driven).name if of_joint else None,
                "gear": float(model.actuator_gear[index, 0]),
                "control_range": limits.tolist() if model.actuator_ctrllimited[index] else None,
            }
        )
    return found


def control(env: Robot) -> dict[str, list[float]] | None:
    """Return how the task maps an action to control: clip(offset + scale * action, low, high).

    The control is the position of a joint where `actuators` has no gear. None if the mapping has
    another form.
    """
    scales = env.scales()
    if scales is not None:
        scale, offset = (torch.tensor(values, dtype=torch.float32) for values in scales)
        return _plain(scale, offset, offset - scale.abs(), offset + scale.abs())
    if not isinstance(env, Environment) or env.action_size != env.physics.model.nu:
        return None

    def made(action: torch.Tensor) -> torch.Tensor:
        env.apply(action.expand(1, env.action_size))
        return env.physics.ctrl[0].clone()

    whole = torch.tensor([0.0, -1.0, 1.0, STEP], dtype=torch.float32)
    offset, one_end, other_end, near = map(made, whole)
    low, high = torch.minimum(one_end, other_end), torch.maximum(one_end, other_end)
    scale = (near - offset) / STEP
    draws = torch.rand(64, env.action_size, generator=torch.Generator(), dtype=torch.float32)
    for action in 2 * draws - 1:
        if not torch.allclose(made(action), (offset + scale * action).clamp(low, high), atol=1e-5):
            return None
    return _plain(scale, offset, low, high)


def _plain(*values: torch.Tensor) -> dict[str, list[float]]:
    names = ("scale", "offset", "low", "high")
    return {name: value.tolist() for name, value in zip(names, values, strict=True)}
