"""Quadruped ant: move along x, along y and, with three objectives, use little control."""

from functools import cached_property

import mujoco
import torch
from pydantic import NonNegativeFloat
from torch import Tensor

from ...worlds.layout import Part
from ...worlds.options import TaskOptions
from ...worlds.section import Count
from ..bodies import Bodies, sense_contacts
from ..gymnasium_robot import GymnasiumRobot


class Ant(GymnasiumRobot):
    """mo-ant-v5.

    Velocity is computed from `qpos`. The original uses the torso's body position, which the RK4
    integrator leaves at its last stage. Contact forces describe the state before the last physics
    step; the original's describe that last RK4 stage.
    """

    model_file = "ant.xml"
    substeps = 5
    unobserved = 2

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {
            "vx": {"vx": 1.0},
            "vy": {"vy": 1.0},
            "control": {"ctrl_cost": -1.0},
        }
        shared: dict[str, float] = {"healthy": 1.0, "contact_cost": -0.0005}
        reference_point: tuple[float, ...] | None = (-100.0, -100.0, -8000.0)
        episode_length: Count = 1000
        reset_noise: NonNegativeFloat = 0.1
        nconmax: int = 32
        njmax: int = 136
        include_cfrc_ext_in_observation: bool = True
        """Observe the contact forces on each body (78 numbers)."""

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        sense_contacts(spec)

    @cached_property
    def bodies(self) -> Bodies:
        return Bodies(self.physics)

    def contact_forces(self) -> Tensor:
        """Return contact torques (N m) and forces (N), (N, 78), each clipped to [-1, 1]."""
        return self.bodies.contact_forces().flatten(1).clamp(-1, 1)

    def observe(self) -> Tensor:
        if not self.options.include_cfrc_ext_in_observation:
            return super().observe()
        return torch.cat([super().observe(), self.contact_forces()], -1)

    def layout(self) -> list[Part]:
        if not self.options.include_cfrc_ext_in_observation:
            return super().layout()
        return [*super().layout(), Part("contact_forces", self.contact_forces().shape[1], "N m, N")]

    def terms(self) -> dict[str, Tensor]:
        vx, vy = self.velocity().unbind(-1)
        return {
            "healthy": (~self.failed()).to(vx),
            "contact_cost": self.contact_forces().square().sum(-1),
            "ctrl_cost": self.effort(),
            "vx": vx,
            "vy": vy,
        }

    def failed(self) -> Tensor:
        height = self.physics.qpos[:, 2]
        return ~((height >= 0.2) & (height <= 1.0))


class Ant2(Ant):
    """mo-ant-2obj-v5: control is a cost instead of an objective."""

    class Options(Ant.Options):
        objectives: dict[str, dict[str, float]] = {"vx": {"vx": 1.0}, "vy": {"vy": 1.0}}
        shared: dict[str, float] = {"healthy": 1.0, "contact_cost": -0.0005, "ctrl_cost": -0.5}
        reference_point: tuple[float, ...] | None = (-100.0, -100.0)
