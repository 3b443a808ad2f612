"""What a robot of mjlab does under velocity commands, in physical units."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

NAMES = (
    "velocity error (m/s)",  # between commanded and actual velocity, mjlab's metric error_vel_xy
    "speed (m/s)",
    "speed (share of the commanded)",  # along commands faster than SLOWEST
    "power (W)",  # positive mechanical power, summed over the joints
    "torque (N m)",  # root mean square over joints and time
    "cost of transport",  # power / (weight * speed)
)
LOWER_IS_BETTER = ("velocity error (m/s)", "power (W)", "torque (N m)", "cost of transport")

SLOWEST = 0.3  # m/s; slower commands say little about walking


def measure(term: Any) -> Tensor:
    """Return numbers of a command term's robot (N, 6), for `quantify`.

    They are its error, its speed, its speed along the command, what was commanded, its power and
    its mean squared torque.
    """
    data, wish = term.robot.data, term.command[:, :2]
    velocity, torque = data.root_link_lin_vel_b[:, :2], data.qfrc_actuator
    power = (torque * data.joint_vel).clamp(min=0).sum(1)
    error, speed = (wish - velocity).norm(dim=1), velocity.norm(dim=1)
    asked = wish.norm(dim=1)
    fast = (asked > SLOWEST) / asked.clamp(min=SLOWEST)
    along = (velocity * wish).sum(1) * fast
    return torch.stack([error, speed, along, asked**2 * fast, power, torque.square().mean(1)], 1)


def quantify(model: Any, means: np.ndarray) -> np.ndarray:
    """Compute the quantities (K, 6) of NAMES from means (K, 6) of `measure` in a mj_model."""
    error, speed, along, asked, power, torque = means.T
    weight = model.body_mass.sum() * np.linalg.norm(model.opt.gravity)
    # a robot that stands has no cost of transport; a large one says so in figures
    share, cost = along / asked.clip(1e-9), power / (weight * speed.clip(0.01))
    return np.stack([error, speed, share, power, torque**0.5, cost], 1)
