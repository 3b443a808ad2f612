"""What a camera follows."""

import mujoco
import numpy as np


def followed_body(model: mujoco.MjModel) -> int:
    """Return the first body that has a joint, or body 1."""
    return int(next(iter(np.flatnonzero(model.body_dofnum)), 1))
