"""Per-body quantities of mjData, rebuilt from sensors so that both simulators provide them."""

import mujoco
import torch
from torch import Tensor

from ..physics.interface import Physics

CENTER, CONTACT, JOINT_FORCE = "center", "contact", "joint_force"
POSITION, ORIENTATION, LINEAR, ANGULAR = "position", "orientation", "linear", "angular"
WRENCH = sum(
    1 << int(field)
    for field in (
        mujoco.mjtConDataField.mjCONDATA_FORCE,
        mujoco.mjtConDataField.mjCONDATA_TORQUE,
        mujoco.mjtConDataField.mjCONDATA_POS,
    )
)
NET = 3  # reduces all contacts of a body to one wrench


def sense_contacts(spec: mujoco.MjSpec) -> None:
    """Add the sensors that `Bodies.contact_forces` reads."""
    bodies = _bodies(spec)
    _add(spec, CENTER, mujoco.mjtSensor.mjSENS_SUBTREECOM, mujoco.mjtObj.mjOBJ_BODY, bodies[:1])
    for sensor in _add(
        spec, CONTACT, mujoco.mjtSensor.mjSENS_CONTACT, mujoco.mjtObj.mjOBJ_BODY, bodies
    ):
        sensor.intprm[:3] = WRENCH, NET, 1


def sense_motion(spec: mujoco.MjSpec) -> None:
    """Add the sensors that the other methods of `Bodies` need in addition to `sense_contacts`."""
    for name, kind in {
        POSITION: mujoco.mjtSensor.mjSENS_FRAMEPOS,
        ORIENTATION: mujoco.mjtSensor.mjSENS_FRAMEQUAT,
        LINEAR: mujoco.mjtSensor.mjSENS_FRAMELINVEL,
        ANGULAR: mujoco.mjtSensor.mjSENS_FRAMEANGVEL,
    }.items():
        _add(spec, name, kind, mujoco.mjtObj.mjOBJ_BODY, _bodies(spec))
    hinges = [joint.name for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    force = mujoco.mjtSensor.mjSENS_JOINTACTFRC
    _add(spec, JOINT_FORCE, force, mujoco.mjtObj.mjOBJ_JOINT, hinges)


class Bodies:
    """The mjData fields cinert, cvel, cfrc_ext and qfrc_actuator, computed from sensors.

    Quantities are about the robot's center of mass, in world axes. Like every sensor, they
    describe the state before the last physics step. The world body and the robot's root joint are
    omitted, since their entries are always zero.

    Args:
        physics: a simulation of a model with the sensors of `sense_contacts`, and of `sense_motion`
            for every quantity but `center` and `contact_forces`.
    """

    def __init__(self, physics: Physics):
        self.physics = physics
        self._views: dict[str, Tensor] = {}
        mass, inertia = physics.model.body_mass, physics.model.body_inertia
        self._mass = torch.from_numpy(mass[1:, None]).to(physics.qpos)
        self._principal = torch.from_numpy(inertia[1:, :, None]).to(physics.qpos)
        self._identity = torch.eye(3, dtype=torch.float32).to(physics.qpos)

    @property
    def center(self) -> Tensor:
        """Return the robot's center of mass (N, 3) in m, as a view."""
        return self._sensors(CENTER)[:, 0]

    def contact_forces(self) -> Tensor:
        """Return cfrc_ext (N, B, 6): torque (N m) and force (N) of all contacts on each body."""
        force, torque, place = self._sensors(CONTACT).split(3, -1)
        arm = place - self.center[:, None]
        return -torch.cat([torque + torch.linalg.cross(arm, force), force], -1)

    def inertias(self) -> Tensor:
        """Return cinert (N, B, 10), the inertia of each body.

        The numbers are the moments xx, yy, zz, xy, xz, yz (kg m^2), mass times position (kg m), and
        mass (kg).
        """
        arm = self._sensors(POSITION) - self.center[:, None]
        axes = _rotation(self._sensors(ORIENTATION))
        square = arm.square().sum(-1)[..., None, None]
        parallel = square * self._identity - arm[..., :, None] * arm[..., None, :]
        moments = axes @ (self._principal * axes.mT) + self._mass[..., None] * parallel
        parts = [moments[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        return torch.cat(
            [torch.stack(parts, -1), self._mass * arm, self._mass.expand_as(arm[..., :1])], -1
        )

    def velocities(self) -> Tensor:
        """Return cvel (N, B, 6): angular (rad/s) and linear velocity (m/s) of each body.

        The linear velocity is that of the body's point at the robot's center of mass.
        """
        angular = self._sensors(ANGULAR)
        arm = self.center[:, None] - self._sensors(POSITION)
        linear = self._sensors(LINEAR) + torch.linalg.cross(angular, arm)
        return torch.cat([angular, linear], -1)

    @property
    def joint_forces(self) -> Tensor:
        """Return qfrc_actuator (N, J): the motor torque on each hinge in N m, as a view."""
        return self._sensors(JOINT_FORCE)[..., 0]

    def _sensors(self, name: str) -> Tensor:
        """Return the readings (N, objects, dim) of the sensors added as `name`, as a view."""
        if name not in self._views:
            model = self.physics.model
            mine = [i for i in range(model.nsensor) if model.sensor(i).name.startswith(f"{name}/")]
            begin = model.sensor_adr[mine[0]]
            end = model.sensor_adr[mine[-1]] + model.sensor_dim[mine[-1]]
            self._views[name] = self.physics.sensors[:, begin:end].unflatten(1, (len(mine), -1))
        return self._views[name]


def _bodies(spec: mujoco.MjSpec) -> list[str]:
    """Return the names of all bodies except the world, naming the unnamed ones."""
    for number, body in enumerate(spec.bodies):
        body.name = body.name or f"body_{number}"
    return [body.name for body in spec.bodies[1:]]


def _add(
    spec: mujoco.MjSpec,
    name: str,
    kind: mujoco.mjtSensor,
    objects_kind: mujoco.mjtObj,
    objects: list[str],
) -> list[mujoco.MjsSensor]:
    """Add one sensor per object, next to each other in `sensordata`."""
    return [
        spec.add_sensor(name=f"{name}/{each}", type=kind, objtype=objects_kind, objname=each)
        for each in objects
    ]


def _rotation(quaternion: Tensor) -> Tensor:
    """Return the rotation matrices (..., 3, 3) of unit quaternions (..., 4), w first."""
    w, x, y, z = quaternion.unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))
