"""Forces at a robot's contacts, as arrows."""

import mujoco
import numpy as np
from numpy.typing import NDArray

WEIGHT = 0.5  # length of an arrow that carries the robot's weight, in sizes of the robot


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
