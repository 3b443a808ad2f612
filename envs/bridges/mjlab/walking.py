"""How robots of mjlab's velocity tasks walk: what evaluations measure besides returns."""

from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from ...errors import MorlaxError
from ...worlds.mirror import reflections

QUANTITIES = (
    "velocity error (m/s)",  # between commanded and actual velocity, mjlab's metric error_vel_xy
    "turning error (rad/s)",  # the same of turning, mjlab's error_vel_yaw
    "speed (m/s)",
    "speed (share of the commanded)",  # along commands faster than SLOWEST
    "power (W)",  # positive mechanical power, summed over the joints
    "torque (N m)",  # root mean square over joints and time
    "cost of transport",  # power / (weight * speed)
    "hottest joint (share of its torque limit)",  # root mean square of its torque over time
    "acceleration of the base (m/s²)",  # root mean square
    "landing force (share of the weight)",  # of a foot, when it begins to touch the ground
    "asymmetry (share)",  # of the torques of a joint and of its partner: their difference by sum
    "drift (m/s)",  # speed when told to stand
    "falls (per 1,000 steps)",  # episodes that fail, by control steps
)
LOWER_IS_BETTER = tuple(name for name in QUANTITIES if not name.startswith("speed"))
SLOWEST = 0.3  # m/s; slower commands say little about walking
COLUMNS = 12  # of `Walking.measure`, before those of joints


class Measures:
    """Measures N robots of an environment of mjlab, to which a term of mjlab gives commands."""

    def __init__(self, env: Any, command: Any):
        self._env, self._command, self._robot = env, command, command.robot
        self._model, indexing = env.sim.mj_model, self._robot.indexing
        self._base = indexing.free_joint_v_adr[:3]
        limits = torque_limits(self._model)[indexing.joint_v_adr.cpu().numpy()]
        self._limits = torch.from_numpy(limits).float().to(indexing.joint_v_adr.device)
        weight = self._model.body_mass.sum() * np.linalg.norm(self._model.opt.gravity)
        self._weight = float(weight)  # N


class Walking(Measures):
    """Measures robots that follow a velocity command."""

    def __init__(self, env: Any, command: Any):
        super().__init__(env, command)
        sensors = env.scene.sensors.values()
        self._feet = next((sensor for sensor in sensors if _touches(sensor.cfg)), None)
        dofs = self._robot.indexing.joint_v_adr.tolist()
        try:
            images = reflections(self._model).velocities.order[dofs].tolist()
        except MorlaxError:
            images = []
        self._partners = [dofs.index(image) for image in images if image in dofs]

    def measure(self) -> Tensor:
        """Return numbers of this step, (N, COLUMNS + joints), to take means of."""
        data, twist = self._robot.data, self._command.command
        wish, velocity, torque = twist[:, :2], data.root_link_lin_vel_b[:, :2], data.qfrc_actuator
        error = (wish - velocity).norm(dim=1)
        turning = (twist[:, 2] - data.root_link_ang_vel_b[:, 2]).abs()
        power = (torque * data.joint_vel).clamp(min=0).sum(1)
        speed, asked = velocity.norm(dim=1), wish.norm(dim=1)
        fast = (asked > SLOWEST) / asked.clamp(min=SLOWEST)
        along, effort = (velocity * wish).sum(1) * fast, torque.square().mean(1)
        jolts = data.data.qacc[:, self._base].square().sum(1)
        standing = (twist == 0).all(1).to(speed.dtype)
        walked = error, turning, speed, along, asked**2 * fast, power, effort, jolts
        numbers = torch.stack([*walked, speed * standing, standing, *self._landings(speed)], 1)
        return torch.cat([numbers, (torque / self._limits).square()], 1)

    def _landings(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """Return the force of feet that land, in weights, and their number, (N,) each."""
        if self._feet is None:
            return torch.zeros_like(like), torch.zeros_like(like)
        landing = self._feet.compute_first_contact(dt=self._env.step_dt).to(like.dtype)
        force = self._feet.data.force.norm(dim=-1) / self._weight
        return (force * landing).sum(1), landing.sum(1)

    def quantify(self, means: np.ndarray, falls: np.ndarray) -> np.ndarray:
        """Return quantities (K, q) from means over time (K, COLUMNS + joints), and falls a step."""
        numbers, joints = means[:, :COLUMNS].T, means[:, COLUMNS:]
        error, turning, speed, along, asked, power, torque, jolts, *others = numbers
        drift, standing, force, landings = others
        # a robot that stands has no cost of transport; a large one says so in figures
        cost, hottest = power / (self._weight * speed.clip(0.01)), joints.max(1) ** 0.5
        share, force, drift = map(_per, (along, force, drift), (asked, landings, standing))
        rest = hottest, jolts**0.5, force, self._asymmetry(joints**0.5), drift, 1000 * falls
        return np.stack([error, turning, speed, share, power, torque**0.5, cost, *rest], 1)

    def _asymmetry(self, torques: np.ndarray) -> np.ndarray:
        """Return the share (K,) that two sides differ by, given means of joints (K, J)."""
        if len(self._partners) < torques.shape[1]:
            return np.full(len(torques), np.nan)
        others = torques[:, self._partners]
        return abs(torques - others).sum(1) / (torques + others).sum(1).clip(1e-9)


def _per(total: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return totals (K,) by counts (K,); NaN where nothing was counted."""
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def _touches(cfg: Any) -> bool:
    """Return whether a sensor's config is that of feet on the ground."""
    return getattr(cfg, "track_air_time", False) and "force" in cfg.fields


def torque_limits(model: mujoco.MjModel) -> np.ndarray:
    """Return the largest torque on each degree of freedom by its actuators; infinite: unlimited."""
    limits = np.full(model.nv, np.inf)
    of_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    limited = np.flatnonzero(of_joint & (model.actuator_forcelimited != 0))
    dofs = model.jnt_dofadr[model.actuator_trnid[limited, 0]]
    limits[dofs] = abs(model.actuator_gear[limited, 0]) * model.actuator_forcerange[limited, 1]
    joints = np.flatnonzero(model.jnt_actfrclimited)  # limits of their own
    dofs = model.jnt_dofadr[joints]
    limits[dofs] = np.minimum(limits[dofs], model.jnt_actfrcrange[joints, 1])
    return limits
