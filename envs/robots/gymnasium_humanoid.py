"""Gymnasium's humanoid, whose observation includes per-body quantities of mjData."""

from functools import cached_property

import mujoco
import torch
from torch import Tensor

from ..worlds.layout import Part
from ..worlds.options import TaskOptions
from .bodies import Bodies, sense_contacts, sense_motion
from .gymnasium_robot import GymnasiumRobot


class HumanoidOptions(TaskOptions):
    """The options of gymnasium's humanoid, under gymnasium's names."""

    include_cinert_in_observation: bool = True
    """Observe the inertia of each body (130 numbers)."""
    include_cvel_in_observation: bool = True
    """Observe the velocity of each body (78 numbers)."""
    include_qfrc_actuator_in_observation: bool = True
    """Observe the motor torques (17 numbers)."""
    include_cfrc_ext_in_observation: bool = True
    """Observe the contact forces on each body (78 numbers)."""
    nconmax: int = 48
    njmax: int = 96


class GymnasiumHumanoid(GymnasiumRobot):
    """Gymnasium's humanoid; its velocity is that of the center of mass.

    The center of mass and the per-body observations lag one physics step (3 ms) behind positions
    and velocities. In gymnasium they come from the last stage of the RK4 integrator.
    """

    model_file = "humanoid.xml"
    substeps = 5
    unobserved = 2

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        sense_contacts(spec)
        sense_motion(spec)

    @cached_property
    def bodies(self) -> Bodies:
        return Bodies(self.physics)

    def place(self) -> Tensor:
        return self.bodies.center[:, :2]

    def observe(self) -> Tensor:
        return torch.cat([super().observe(), *self._of_bodies().values()], -1)

    def layout(self) -> list[Part]:
        units = {"inertias": "kg m^2, kg m, kg", "velocities": "rad/s, m/s"}
        extra = self._of_bodies().items()
        own = [Part(name, x.shape[1], units.get(name, "N m, N")) for name, x in extra]
        return [*super().layout(), *own]

    def _of_bodies(self) -> dict[str, Tensor]:
        """Return the observed per-body quantities (N, ...) by name, in gymnasium's order."""
        options, bodies, seen = self.options, self.bodies, {}
        if options.include_cinert_in_observation:
            seen["inertias"] = bodies.inertias().flatten(1)
        if options.include_cvel_in_observation:
            seen["velocities"] = bodies.velocities().flatten(1)
        if options.include_qfrc_actuator_in_observation:
            seen["joint_forces"] = bodies.joint_forces
        if options.include_cfrc_ext_in_observation:
            seen["contact_forces"] = bodies.contact_forces().flatten(1)
        return seen
