"""Humanoid: run as fast as possible, use little energy."""

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from ..worlds.environment import Environment
from ..worlds.mujoco_robot import Part, positions, velocities
from ..worlds.options import Objectives, TaskOptions

ACTION_SCALE = 3.0  # the motors clip control to [-1, 1]; the energy term uses the unclipped action
EXTREMITIES = ("right_hand", "left_hand", "right_foot", "left_foot")


class Humanoid(Environment):
    """The paper's humanoid.

    Sensors measure the head, the torso axes, the center of mass and its velocity, so these lag one
    physics step.
    """

    model_file = "assets/humanoid.xml"
    substeps = 2
    paper_reset_terms = {"alive": 1.0, "run": 1.0, "energy": 3.0}

    class Options(TaskOptions):
        objectives: Objectives = {"run": {"run": 1.0}, "energy": {"energy": 1.0}}
        shared: dict[str, float] = {"alive": 1.0}
        nconmax: int = 8
        njmax: int = 53
        extremities: bool = False
        """Observe positions of hands and feet (12 numbers) instead of the paper's three zeros."""

    @cached_property
    def extremities(self) -> list[Tensor]:
        if self.options.extremities:
            return [self.physics.sensor(name) for name in EXTREMITIES]
        return [torch.zeros_like(self.physics.sensor("center"))]

    def initial_qpos(self) -> np.ndarray:
        qpos = np.zeros(self.physics.model.nq)
        qpos[2:4] = 1.4, 1.0  # height in m; upright (quaternion w)
        return qpos

    def observe(self) -> Tensor:
        sensor = self.physics.sensor
        return torch.cat(
            [
                self.physics.qpos[:, 7:],
                sensor("head")[:, 2:],
                *self.extremities,
                *(sensor(f"torso_{axis}")[:, 2:] for axis in "xyz"),
                sensor("velocity"),
                self.physics.qvel,
            ],
            -1,
        )

    def layout(self) -> list[Part]:
        model = self.physics.model
        if self.options.extremities:
            extremities = [Part(f"position.{name}", 3, "m, from the torso") for name in EXTREMITIES]
        else:
            extremities = [Part("zeros", 3, "")]
        return [
            *positions(model)[4:],
            Part("position.head.z", 1, "m"),
            *extremities,
            *(Part(f"torso.{axis}.z", 1, "world-z of the torso's own axis") for axis in "xyz"),
            Part("velocity.center", 3, "m/s, of the center of mass, in the world"),
            *velocities(model),
        ]

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_(ACTION_SCALE * action)

    def remember(self) -> dict[str, Tensor]:
        return {"x": self.physics.sensor("center")[:, 0]}

    def terms(self) -> dict[str, Tensor]:
        x = self.physics.sensor("center")[:, 0]
        action = self.physics.ctrl / ACTION_SCALE
        return {
            "alive": torch.ones_like(x),
            "run": (x - self.memory["x"]) / self.dt,
            "energy": (3.0 - action.square().sum(-1)).clamp(min=0.0),
        }

    def failed(self) -> Tensor:
        return self.physics.qpos[:, 2] < 0.6
