"""What a robot of mjlab does under velocity commands, in physical units."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

NAMES = (
    "velocity error (m/s)",  # between commanded and actual velocity, mjlab's metric error_vel_xy
    "speed (m/s)",
    "power (W)",  # positive mechanical power, summed over the joints
    "torque (N m)",  # root mean square over joints and time
    "cost of transport",  # power / (weight * speed)
)


def measure(term: Any) -> Tensor:
    """Return error, speed, power and mean squared torque (N, 4) of a command term's robot."""
    data, wish = term.robot.data, term.command[:, :2]
    velocity, torque = data.root_link_lin_vel_b[:, :2], data.qfrc_actuator
    power = (torque * data.joint_vel).clamp(min=0).sum(1)
    error, speed = (wish - velocity).norm(dim=1), velocity.norm(dim=1)
    return torch.stack([error, speed, power, torque.square().mean(1)], 1)


def quantify(model: Any, means: np.ndarray) -> np.ndarray:
    """Compute the quantities (K, 5) of NAMES from means (K, 4) of `measure` in a mj_model."""
    error, speed, power, torque = means.T
    weight = model.body_mass.sum() * np.linalg.norm(model.opt.gravity)
    # a robot that stands has no cost of transport; a large one says so in figures
    return np.stack([error, speed, power, torque**0.5, power / (weight * speed.clip(0.01))], 1)
