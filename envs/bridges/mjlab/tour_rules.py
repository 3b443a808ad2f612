"""Rules of the tour that training in mjlab and scoring in C MuJoCo share; needs no mjlab.

They are those of the public teleop-walking-benchmark (rhoyn, 2026).
"""

from typing import Any

TASK = "Mjlab-Tour-Flat-Unitree-G1"
OWNED = (".*_hip_.*", ".*_knee_.*", ".*_ankle_.*", "waist_.*")  # joints of the policy
ARM = (
    *("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"),
    *("wrist_roll", "wrist_pitch", "wrist_yaw"),
)
ARMS = tuple(f"{side}_{joint}_joint" for side in ("left", "right") for joint in ARM)
MIRROR = (1.0, -1.0, -1.0, 1.0, -1.0, 1.0, -1.0)  # from the left arm to the right one
WEAKER, TORQUE = "_hip_roll_", 88.0  # joints with less torque than mjlab's; N m
WINDOW, WANDER = 0.5, 0.06  # s between targets; rad, the largest change of a control step
SEGMENT, DELAY, DURATION = 5.0, 0.1, 0.08  # s between punches, before the first, of each
STRONGEST, RAMP, WEAKEST = 500.0, 60.0, 1 / 3  # N; s until punches are so strong; share at first
LIGHTEST = 0.5  # share of the strongest punch that is possible at a time
GAIN = 1.5  # 1/s, from errors of position and heading to commands


def strongest(climbed: Any) -> Any:
    """Return the size in N of the strongest punch after shares in [0, 1] of RAMP."""
    return STRONGEST * (WEAKEST + (1 - WEAKEST) * climbed)
