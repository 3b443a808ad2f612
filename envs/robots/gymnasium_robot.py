"""Base classes for robots of other benchmarks, loaded from the MJCF in the gymnasium package.

The fields cinert, cvel, cfrc_ext and qfrc_actuator of mjData are rebuilt from sensors, so that both
simulators provide them. They are about the robot's center of mass, in world axes and, like every
sensor, of the state before the last physics step. The world body and the robot's root joint are
omitted, since their entries are always zero.
"""

from functools import cached_property
from importlib import resources

import mujoco
import numpy as np
import torch
from mujoco import mjtObj, mjtSensor
from pydantic import NonNegativeFloat
from torch import Tensor

from ..worlds.options import Count, TaskOptions
from .runner import Runner

WRENCH = sum(
    1 << int(getattr(mujoco.mjtConDataField, f"mjCONDATA_{field}"))
    for field in ("FORCE", "TORQUE", "POS")
)
NET = 3  # reduces all contacts of a body to one wrench


def sense(spec: mujoco.MjSpec, motion: bool = False) -> None:
    """Name all bodies, and add the sensors of contacts and, for `GymnasiumHumanoid`, of motion.

    Those of one kind lie next to each other in `sensordata`.
    """
    for number, body in enumerate(spec.bodies):
        body.name = body.name or f"body_{number}"
    bodies = [body.name for body in spec.bodies[1:]]
    hinges = [joint.name for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    sensors = [("center", mjtSensor.mjSENS_SUBTREECOM, bodies[:1])]
    sensors += [("contact", mjtSensor.mjSENS_CONTACT, bodies)]
    if motion:
        sensors += [
            ("position", mjtSensor.mjSENS_FRAMEPOS, bodies),
            ("orientation", mjtSensor.mjSENS_FRAMEQUAT, bodies),
            ("linear", mjtSensor.mjSENS_FRAMELINVEL, bodies),
            ("angular", mjtSensor.mjSENS_FRAMEANGVEL, bodies),
            ("joint_force", mjtSensor.mjSENS_JOINTACTFRC, hinges),
        ]
    for name, kind, objects in sensors:
        of = mjtObj.mjOBJ_JOINT if objects is hinges else mjtObj.mjOBJ_BODY
        for each in objects:
            sensor = spec.add_sensor(name=f"{name}/{each}", type=kind, objtype=of, objname=each)
            if name == "contact":
                sensor.intprm[:3] = WRENCH, NET, 1


def _rotation(quaternion: Tensor, identity: Tensor) -> Tensor:
    """Return the rotation matrices (N, B, 3, 3) of unit quaternions (N, B, 4), w first."""
    w, axis = quaternion[..., :1, None], quaternion[..., None, 1:]
    crossed = torch.linalg.cross(identity, axis)  # the matrix of the cross product with the axis
    return (2 * w * w - 1) * identity + 2 * (axis.mT * axis + w * crossed)  # Rodrigues


class GymnasiumRobot(Runner):
    """A gymnasium robot whose actions in [-1, 1] span the control range of each motor.

    Actions outside [-1, 1] are clipped. Every robot uses the Newton constraint solver, because
    MuJoCo Warp lacks PGS, the solver that gymnasium's humanoid selects.
    """

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
        """Apply the benchmark's changes to gymnasium's robot and add sensors, in place."""

    @cached_property
    def control_range(self) -> tuple[Tensor, Tensor]:
        """Return the center and half width (A,) of each motor's control range."""
        low, high = torch.from_numpy(self.physics.model.actuator_ctrlrange).to(self.physics.ctrl).T
        return (low + high) / 2, (high - low) / 2

    @cached_property
    def sensed(self) -> dict[str, Tensor]:
        """Return readings (N, objects, dim) by the name of the added sensors, as views."""
        model, views = self.physics.model, {}
        names = [model.sensor(i).name.partition("/")[0] for i in range(model.nsensor)]
        for name in dict.fromkeys(names):
            first, number = names.index(name), names.count(name)
            start, dim = model.sensor_adr[first], model.sensor_dim[first]
            readings = self.physics.sensors[:, start : start + number * dim]
            views[name] = readings.unflatten(1, (number, dim))
        return views

    def contact_forces(self) -> Tensor:
        """Return cfrc_ext (N, B, 6): torque (N m) and force (N) of all contacts on each body."""
        force, torque, point = self.sensed["contact"].split(3, -1)
        arm = point - self.sensed["center"]
        return -torch.cat([torque + torch.linalg.cross(arm, force), force], -1)

    def initial_qpos(self) -> np.ndarray:
        return self.physics.model.qpos0.copy()

    def apply(self, action: Tensor) -> None:
        middle, reach = self.control_range
        self.physics.ctrl.copy_(middle + reach * action.clamp(-1, 1))

    def terms(self) -> dict[str, Tensor]:
        return {"run": self.speed(), "ctrl_cost": self.effort()}

    def healthy(self) -> Tensor:
        """Return 1 where the robot has not failed, else 0, (N,)."""
        return (~self.failed()).to(self.physics.qpos)

    def failed(self) -> Tensor:
        return torch.zeros_like(self.age, dtype=torch.bool)


class HumanoidOptions(TaskOptions):
    """The options of gymnasium's humanoid, under gymnasium's names."""

    episode_length: Count = 1000
    reset_noise: NonNegativeFloat = 0.01
    include_cinert_in_observation: bool = True
    """Observe the inertia of each body (130 numbers)."""
    include_cvel_in_observation: bool = True
    """Observe the velocity of each body (78 numbers)."""
    include_qfrc_actuator_in_observation: bool = True
    """Observe the motor torques (17 numbers)."""
    include_cfrc_ext_in_observation: bool = True
    """Observe the contact forces on each body (78 numbers)."""
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
        sense(spec, motion=True)

    @cached_property
    def _constants(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return mass (B, 1) and principal moments (B, 3, 1) of each body, and a matrix of one."""
        like, model = self.physics.qpos, self.physics.model
        mass = torch.from_numpy(model.body_mass[1:, None]).to(like)
        principal = torch.from_numpy(model.body_inertia[1:, :, None]).to(like)
        return mass, principal, torch.eye(3, dtype=like.dtype, device=like.device)[None, None]

    def inertias(self) -> Tensor:
        """Return cinert (N, B, 10), the inertia of each body.

        The numbers are the moments xx, yy, zz, xy, xz, yz (kg m^2), mass times position (kg m), and
        mass (kg).
        """
        mass, principal, identity = self._constants
        arm = self.sensed["position"] - self.sensed["center"]
        axes = _rotation(self.sensed["orientation"], identity)
        square = arm.square().sum(-1)[..., None, None]
        parallel = square * identity - arm[..., :, None] * arm[..., None, :]
        moments = axes @ (principal * axes.mT) + mass[..., None] * parallel
        parts = [moments[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        return torch.cat([torch.stack(parts, -1), mass * arm, mass.expand_as(arm[..., :1])], -1)

    def velocities(self) -> Tensor:
        """Return cvel (N, B, 6): angular (rad/s) and linear velocity (m/s) of each body.

        The linear velocity is that of the body's point at the robot's center of mass.
        """
        angular = self.sensed["angular"]
        arm = self.sensed["center"] - self.sensed["position"]
        linear = self.sensed["linear"] + torch.linalg.cross(angular, arm)
        return torch.cat([angular, linear], -1)

    def place(self) -> Tensor:
        return self.sensed["center"][:, 0, :2]

    def seen_of_bodies(self) -> dict[str, Tensor]:
        options, seen = self.options, {}  # in gymnasium's order
        if options.include_cinert_in_observation:
            seen["inertias"] = self.inertias().flatten(1)
        if options.include_cvel_in_observation:
            seen["velocities"] = self.velocities().flatten(1)
        if options.include_qfrc_actuator_in_observation:
            seen["joint_forces"] = self.sensed["joint_force"][..., 0]
        if options.include_cfrc_ext_in_observation:
            seen["contact_forces"] = self.contact_forces().flatten(1)
        return seen
