"""The motion beside an export, frame by frame."""

import io
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...envs import MorlaxError
from ...envs.errors import line
from ...host.files import read

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """T frames of J joints and K key bodies, the first of which is the base."""

    joints: Array  # (T, J): rad
    speeds: Array  # (T, J): rad/s
    places: Array  # (T, K, 3): m, in the world
    turns: Array  # (T, K, 4): quaternions, w first


NAMES = "joint_pos", "joint_vel", "body_pos_w", "body_quat_w"  # mjlab's


def open_motion(path: Path, joints: int, bodies: int) -> Motion:
    """Open the file of a motion of so many joints and key bodies, or raise MorlaxError."""
    content = io.BytesIO(read(path, "motion"))
    try:
        with np.load(content) as file:
            motion = Motion(*(file[name].astype(float) for name in NAMES))
    except (KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise MorlaxError(f"cannot load the motion {path}: {line(error)}.") from None
    frames = len(motion.joints)
    shapes = (frames, joints), (frames, joints), (frames, bodies, 3), (frames, bodies, 4)
    for name, array, shape in zip(NAMES, motion, shapes, strict=True):
        if array.shape != shape:
            raise MorlaxError(f"{name} of the motion {path} is {array.shape} instead of {shape}.")
    return motion
