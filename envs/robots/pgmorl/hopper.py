"""Planar one-legged hopper: run, jump high and, with three objectives, use little energy."""

import math

import mujoco
import torch
from torch import Tensor

from ...worlds.options import TaskOptions
from ..gymnasium_robot import GymnasiumRobot

STANDING = 1.25  # m
MOTORS = ((2.0, 200.0), (2.0, 200.0), (4.0, 300.0))  # control range and gear: thigh, leg, foot


class Hopper(GymnasiumRobot):
    """MO-Hopper-v2: without joint limits, and with two to six times gymnasium's motor torque."""

    model_file = "hopper.xml"
    substeps = 5
    fastest_seen = 10.0

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.5}, "jump": {"jump": 12.0}}
        shared: dict[str, float] = {"alive": 1.0, "ctrl_cost": -0.0002}
        nconmax: int = 12
        njmax: int = 40

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        for joint in spec.joints[3:]:
            joint.damping[0], joint.limited = 40.0, mujoco.mjtLimited.mjLIMITED_FALSE
        for actuator, (reach, gear) in zip(spec.actuators, MOTORS, strict=True):
            actuator.ctrlrange, actuator.gear[0] = [-reach, reach], gear

    def terms(self) -> dict[str, Tensor]:
        speed, effort = self.velocity()[:, 0], self.effort()
        return {
            "alive": torch.ones_like(speed),
            "ctrl_cost": effort,
            "run": speed,
            "jump": self.physics.qpos[:, 1] - STANDING,
            "energy": 4.0 - effort,
        }

    def failed(self) -> Tensor:
        height, angles = self.physics.qpos[:, 1], self.physics.qpos[:, 2:]
        return ~((height > 0.4) & (angles.abs() < math.radians(90)).all(-1))


class Hopper3(Hopper):
    """MO-Hopper-v3: energy is an objective instead of a small cost."""

    class Options(Hopper.Options):
        objectives: dict[str, dict[str, float]] = {
            "run": {"run": 1.5},
            "jump": {"jump": 12.0},
            "energy": {"energy": 1.0},
        }
        shared: dict[str, float] = {"alive": 1.0}
