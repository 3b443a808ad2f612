"""The seven tasks of PG-MORL: "Prediction-Guided Multi-Objective Reinforcement Learning for
Continuous Robot Control", Xu et al., ICML 2020.

Rewards, observations, terminations, frame skips and episode lengths follow the released code. The
robots are gymnasium's, edited at load where the benchmark's MJCF differs. The released code runs an
older MuJoCo, in which the same actions give similar but not identical motions.
"""

import math
from typing import Any

import mujoco
import torch
from torch import Tensor

from ..worlds.options import Objectives, TaskOptions
from . import mo_gymnasium
from .cheetah import MAX_PITCH, MAX_SPEED
from .gymnasium_robot import GymnasiumHumanoid, GymnasiumRobot, HumanoidOptions
from .runner import RunEnergy, Runner

# Control range and gear of the hopper: thigh, leg, foot.
MOTORS = ((2.0, 200.0), (2.0, 200.0), (4.0, 300.0))


class HalfCheetah(mo_gymnasium.HalfCheetah):
    """MO-HalfCheetah-v2: run fast, use little energy."""

    Options: Any = RunEnergy

    def terms(self) -> dict[str, Tensor]:
        terms = Runner.terms(self)
        return {**terms, "run": terms["run"].clamp(max=MAX_SPEED)}

    def failed(self) -> Tensor:
        return ~(self.physics.qpos[:, 2].abs() < MAX_PITCH)


class Hopper(mo_gymnasium.Hopper):
    """MO-Hopper-v2: without joint limits, and with two to six times gymnasium's motor torque."""

    substeps = 5

    class Options(TaskOptions):
        objectives: Objectives = {"run": {"run": 1.5}, "jump": {"jump": 12.0}}
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
        speed, effort = self.speed(), self.effort()
        return {
            "alive": torch.ones_like(speed),
            "ctrl_cost": effort,
            "run": speed,
            "jump": self.physics.qpos[:, 1] - mo_gymnasium.STANDING,
            "energy": 4.0 - effort,
        }

    def failed(self) -> Tensor:
        height, angles = self.physics.qpos[:, 1], self.physics.qpos[:, 2:]
        return ~((height > 0.4) & (angles.abs() < math.radians(90)).all(-1))


class Hopper3(Hopper):
    """MO-Hopper-v3: energy is an objective instead of a small cost."""

    class Options(Hopper.Options):
        objectives: Objectives = {
            "run": {"run": 1.5},
            "jump": {"jump": 12.0},
            "energy": {"energy": 1.0},
        }
        shared: dict[str, float] = {"alive": 1.0}


class Walker2d(mo_gymnasium.Walker2d):
    """MO-Walker2d-v2: run fast, use little energy."""

    model_file = "walker2d.xml"
    Options: Any = RunEnergy
    terms = Runner.terms

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        for joint in spec.joints[3:]:
            joint.damping[0] = 3.0
        for geom in spec.geoms:
            geom.density = 1500.0  # kg/m^3


class Swimmer(mo_gymnasium.Swimmer):
    """MO-Swimmer-v2: swim fast, use little energy."""

    class Options(TaskOptions):
        objectives: Objectives = {"run": {"run": 1.0}, "energy": {"energy": 0.15}}
        nconmax: int = 1
        njmax: int = 4

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        for actuator in spec.actuators:
            actuator.gear[0] = 300.0

    def terms(self) -> dict[str, Tensor]:
        return {"run": self.speed(), "energy": 2.0 - self.effort()}


class Ant(GymnasiumRobot):
    """MO-Ant-v2: move along x, along y. The robot never fails, not even on its back."""

    model_file = "ant.xml"
    substeps = 5
    unobserved = 2

    class Options(TaskOptions):
        objectives: Objectives = {"vx": {"vx": 1.0}, "vy": {"vy": 1.0}}
        shared: dict[str, float] = {"alive": 1.0, "ctrl_cost": -0.5}
        nconmax: int = 32
        njmax: int = 136

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        for actuator in spec.actuators:
            actuator.gear[0] = 100.0

    def terms(self) -> dict[str, Tensor]:
        vx, vy = self.velocity().unbind(-1)
        return {"alive": torch.ones_like(vx), "ctrl_cost": self.effort(), "vx": vx, "vy": vy}


class Humanoid(GymnasiumHumanoid):
    """MO-Humanoid-v2, the only one of the seven with 1000-step episodes and noisy starts.

    The energy term uses the action clipped to the motors' control range.
    """

    class Options(HumanoidOptions):
        objectives: Objectives = {"run": {"run": 1.25}, "energy": {"energy": 1.0}}
        shared: dict[str, float] = {"alive": 3.0}

    def terms(self) -> dict[str, Tensor]:
        speed = self.speed()
        return {"alive": torch.ones_like(speed), "run": speed, "energy": 3.0 - 4.0 * self.effort()}

    def failed(self) -> Tensor:
        height = self.physics.qpos[:, 2]
        return (height < 1.0) | (height > 2.0)
