"""Base classes for robots of other benchmarks, loaded from the MJCF in the gymnasium package."""

import math
from functools import cached_property
from importlib import resources
from typing import ClassVar

import mujoco
import numpy as np
import torch
from torch import Tensor

from ..worlds.environment import Environment
from ..worlds.mujoco_robot import Part, positions, velocities
from ..worlds.options import TaskOptions
from .bodies import Bodies, sense_contacts, sense_motion


class GymnasiumRobot(Environment):
    """A gymnasium robot whose actions in [-1, 1] span the control range of each motor.

    Actions outside [-1, 1] are clipped. Every robot uses the Newton constraint solver, because
    MuJoCo Warp lacks PGS, the solver that gymnasium's humanoid selects.
    """

    unobserved: ClassVar[int] = 1  # leading entries of qpos: position on the floor
    fastest_seen: ClassVar[float] = math.inf  # clipping limit of observed velocities

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        assets = resources.files("gymnasium") / "envs" / "mujoco" / "assets"
        with resources.as_file(assets / cls.model_file) as path:
            spec = mujoco.MjSpec.from_file(str(path))
        floor = spec.geom("floor")
        floor.size = [0.0, 0.0, 1.0]  # rendered infinite, with a 1 m grid
        spec.material(floor.material).texrepeat = [1.0, 1.0]
        spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        cls.edit(spec)
        total, spec.compiler.settotalmass = spec.compiler.settotalmass, -1.0
        model = spec.compile()
        if total > 0:  # kg; MuJoCo warns that it will drop the compiler's option
            mujoco.mj_setTotalmass(model, total)
            mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        """Apply the benchmark's changes to gymnasium's robot and add sensors, in place.

        Args:
            spec: the robot before compilation.
        """

    @cached_property
    def control_range(self) -> tuple[Tensor, Tensor]:
        """Return the center and half width (A,) of each motor's control range."""
        low, high = torch.from_numpy(self.physics.model.actuator_ctrlrange).to(self.physics.ctrl).T
        return (low + high) / 2, (high - low) / 2

    @cached_property
    def bodies(self) -> Bodies:
        """Return per-body quantities, of a robot with their sensors."""
        return Bodies(self.physics)

    def initial_qpos(self) -> np.ndarray:
        return self.physics.model.qpos0.copy()

    def observe(self) -> Tensor:
        positions, velocities = self.physics.qpos[:, self.unobserved :], self.physics.qvel
        return torch.cat([positions, velocities.clamp(-self.fastest_seen, self.fastest_seen)], -1)

    def layout(self) -> list[Part]:
        model, fastest = self.physics.model, self.fastest_seen
        limit = fastest if math.isfinite(fastest) else None
        return [*positions(model)[self.unobserved :], *velocities(model, limit)]

    def apply(self, action: Tensor) -> None:
        middle, reach = self.control_range
        self.physics.ctrl.copy_(middle + reach * action.clamp(-1, 1))

    def place(self) -> Tensor:
        """Return the horizontal position (N, 2) in m, from which `velocity` is computed."""
        return self.physics.qpos[:, :2]

    def remember(self) -> dict[str, Tensor]:
        return {"place": self.place()}

    def velocity(self) -> Tensor:
        """Return the mean velocity (N, 2) over the control step in m/s."""
        return (self.place() - self.memory["place"]) / self.dt

    def effort(self) -> Tensor:
        """Return the sum of squared controls (N,), in units of the motors' control ranges."""
        return self.physics.ctrl.square().sum(-1)

    def failed(self) -> Tensor:
        return torch.zeros_like(self.age, dtype=torch.bool)


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
