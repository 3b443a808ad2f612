"""Gait planning from the model alone: deterministic, without data, 0.1 s per gait.

The center of mass follows a linear inverted pendulum whose pivot is the stance foot; the legs
follow by inverse kinematics. The legs are 61 % of the robot's mass, so the pendulum is inaccurate.
Inverse dynamics therefore computes the center of pressure, and the center of mass is moved until
the center of pressure is at the desired pivot. Frames are those of the stance sole, with the origin
at its center: x forward, y left, z up.
"""

from dataclasses import dataclass
from math import comb

import mujoco
import numpy as np
from gait_library import Constants, Gait
from numpy.typing import NDArray

from morlax_torch.envs.robots.bruce import model as bruce
from morlax_torch.envs.robots.bruce.reference import DEGREE

STANCE = ("right", "left")  # stance foot of the two steps: the left foot swings first
SAMPLES = 41  # per step, in planning
GRAVITY = 9.81  # m/s^2


@dataclass(frozen=True)
class Motion:
    """A gait at S instants of each of its two steps."""

    qpos: NDArray[np.float64]  # (2, S, nq)
    qvel: NDArray[np.float64]  # (2, S, nv)
    qacc: NDArray[np.float64]  # (2, S, nv)


@dataclass(frozen=True)
class Loads:
    """Ground reactions and motor torques of a motion."""

    force: NDArray[np.float64]  # (2, S, 3) N, ground reaction
    pivot: NDArray[np.float64]  # (2, S, 2) m, center of pressure
    yaw_moment: NDArray[np.float64]  # (2, S) N m, about the center of the sole
    torque: NDArray[np.float64]  # (2, S, 16) N m, in motor coordinates


def bernstein(s: NDArray[np.float64], degree: int = DEGREE) -> NDArray[np.float64]:
    """Return the Bernstein weights (S, degree + 1) of a Bezier curve at s (S,) in [0, 1]."""
    k = np.arange(degree + 1)
    choose = np.array([comb(degree, i) for i in k])
    return choose * s[:, None] ** k * (1 - s[:, None]) ** (degree - k)


def derivatives(s: NDArray[np.float64], period: float) -> list[NDArray[np.float64]]:
    """Return matrices (S, 8) from control points to a curve, its velocity and its acceleration.

    Args:
        s: (S,) curve parameters in [0, 1].
        period: duration of the curve in s.
    """
    difference = np.diff(np.eye(DEGREE + 1), axis=0)
    first = DEGREE / period * difference
    second = (DEGREE - 1) / period * difference[:-1, :-1] @ first
    return [
        bernstein(s),
        bernstein(s, DEGREE - 1) @ first,
        bernstein(s, DEGREE - 2) @ second,
    ]


class Planner:
    """Plans gaits and computes their loads by inverse dynamics.

    Args:
        constants: parameters of the gaits (None: the defaults).
    """

    def __init__(self, constants: Constants | None = None):
        self.constants = constants or Constants()
        self.model = bruce.load()
        self._data = mujoco.MjData(self.model)
        self._expand = bruce.joints_from_crank(self.model)
        self._soles = {side: self.model.site(f"{side}_sole").id for side in bruce.SIDES}
        self._phase = np.linspace(0, 1, SAMPLES)
        self._fit = _smooth_fit(self._phase)

    def plan(self, vx: float, vy: float) -> Gait:
        """Plan the gait with a given mean velocity.

        Args:
            vx: velocity forward in m/s.
            vy: velocity to the left in m/s.

        Raises:
            ArithmeticError: the legs cannot reach a planned foot position.
        """
        constants = self.constants
        com, swing = self._pendulum(vx, vy), self._swing_foot(vx, vy)
        gait = self._follow(com, swing)
        for _ in range(constants.rounds):
            loads = self.loads(self.motion(gait, self._phase))
            error = loads.pivot - [constants.pivot, 0.0]
            com[..., :2] -= self._correction(error)
            gait = self._follow(com, swing)
        return gait

    def motion(self, gait: Gait, s: NDArray[np.float64]) -> Motion:
        """Return positions, velocities and accelerations at s (S,) in [0, 1] of each step."""
        curves = []
        for weights in derivatives(s, self.constants.step_time):
            base, joints = weights @ gait.base[..., :3], weights @ gait.joints
            curves.append((base, joints @ self._expand.T))
        upright = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*curves[0][0].shape[:-1], 4))
        qpos = np.concatenate([curves[0][0], upright, curves[0][1]], -1)
        rates = [np.concatenate([b, np.zeros_like(b), j], -1) for b, j in curves[1:]]
        return Motion(qpos, *rates)

    def loads(self, motion: Motion) -> Loads:
        """Compute the ground reactions on the stance foot and the motor torques of a motion."""
        model, data = self.model, self._data
        steps, samples = motion.qpos.shape[:2]
        force, pivot = np.zeros((steps, samples, 3)), np.zeros((steps, samples, 2))
        yaw_moment, torque = np.zeros((steps, samples)), np.zeros((steps, samples, 16))
        needed, armature = np.zeros(model.nv), model.dof_armature
        to_motors = np.linalg.inv(bruce.from_crank(bruce.MOTORS)).T
        for i, stance in enumerate(STANCE[:steps]):
            for k in range(samples):
                self._place(motion.qpos[i, k])
                data.qvel[:], data.qacc[:] = motion.qvel[i, k], motion.qacc[i, k]
                mujoco.mj_comVel(model, data)
                mujoco.mj_rne(model, data, 1, needed)
                sole, jacobian = self._sole(stance)
                f = needed[:3]
                moment = needed[3:6] + np.cross(data.qpos[:3] - sole, f)
                force[i, k] = f
                pivot[i, k] = -moment[1] / f[2], moment[0] / f[2]
                yaw_moment[i, k] = moment[2]
                by_ground = jacobian.T @ np.concatenate([f, moment])
                rest = needed + armature * motion.qacc[i, k] - by_ground
                torque[i, k] = to_motors @ (self._expand.T @ rest[6:])
        return Loads(force, pivot, yaw_moment, torque)

    def _pendulum(self, vx: float, vy: float) -> NDArray[np.float64]:
        """Return the center of mass (2, S, 3) over two steps, each relative to its stance foot."""
        c = self.constants
        T, omega = c.step_time, np.sqrt(GRAVITY / c.com_height)
        length, (to_left, to_right) = vx * T, self._widths(vy)
        step = _flow(omega, np.array([T]))[0]
        sagittal = np.linalg.solve(step - np.eye(2), [length, 0.0])
        first = np.linalg.solve(step @ step - np.eye(2), step @ [to_left, 0.0] - [to_right, 0.0])
        second = step @ first - [to_left, 0.0]
        flow = _flow(omega, T * self._phase)[:, 0]  # (S, 2): positions
        x = c.pivot + flow @ sagittal
        height = np.full_like(x, c.com_height)
        return np.stack([np.stack([x, flow @ lateral, height], -1) for lateral in (first, second)])

    def _swing_foot(self, vx: float, vy: float) -> NDArray[np.float64]:
        """Return the position (2, S, 3) of the swing sole over two steps."""
        c, s = self.constants, self._phase
        to_left, to_right = self._widths(vy)
        length = vx * c.step_time
        ease = s**3 * (10 - 15 * s + 6 * s**2)  # minimum jerk, from 0 to 1
        x = length * (2 * ease - 1)
        z = c.apex * 16 * (s * (1 - s)) ** 2
        # Each swing starts at the foot's position after the other foot's step.
        first = to_right + (to_left - to_right) * ease
        second = -to_left + (to_left - to_right) * ease
        return np.stack([np.stack([x, y, z], -1) for y in (first, second)])

    def _widths(self, vy: float) -> tuple[float, float]:
        """Return the lateral distances of the feet in m after the left and after the right step."""
        sideways = 2 * self.constants.step_time * vy
        return (
            self.constants.width + max(sideways, 0.0),
            self.constants.width + max(-sideways, 0.0),
        )

    def _follow(self, com: NDArray[np.float64], swing: NDArray[np.float64]) -> Gait:
        """Return the gait whose center of mass and swing foot follow the given paths (2, S, 3)."""
        joints = np.zeros((2, SAMPLES, 16))
        base = np.zeros((2, SAMPLES, 6))
        crank = bruce.DEFAULT_POSE.copy()
        for i, stance in enumerate(STANCE):
            position = com[i, 0] + [0.0, 0.0, 0.03]
            for k in range(SAMPLES):
                position, crank = self._solve(position, crank, stance, com[i, k], swing[i, k])
                base[i, k, :3], joints[i, k] = position, crank
        return Gait(self._fitted(joints), self._fitted(base))

    def _solve(
        self,
        position: NDArray[np.float64],
        crank: NDArray[np.float64],
        stance: str,
        com: NDArray[np.float64],
        swing: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Solve inverse kinematics for one instant by Newton's method.

        The torso is upright; the soles point forward and are level in pitch. Their roll follows the
        leg, which has no ankle roll joint.

        Args:
            position: (3,) initial guess of the base position in m.
            crank: (16,) initial guess of the joints in rad.
            stance: side of the stance foot.
            com: (3,) desired center of mass in m.
            swing: (3,) desired position of the swing sole in m.

        Returns:
            The base position (3,) in m and the joints (16,) in rad.

        Raises:
            ArithmeticError: no solution was found.
        """
        model, data, legs = self.model, self._data, bruce.NUM_LEG_JOINTS
        crank, position = crank.copy(), position.copy()
        by_com = np.zeros((3, model.nv))
        for _ in range(30):
            self._place(np.concatenate([position, [1, 0, 0, 0], self._expand @ crank]))
            mujoco.mj_jacSubtreeCom(model, data, by_com, 1)
            errors, rows = [data.subtree_com[1] - com], [by_com]
            for side in bruce.SIDES:
                sole, jacobian = self._sole(side)
                errors.append(sole - (0.0 if side == stance else swing))
                ahead = data.site_xmat[self._soles[side]].reshape(3, 3)[:, 1]
                errors.append(ahead[1:])
                rows += [jacobian[:3], np.cross(jacobian[3:].T, ahead).T[1:]]
            error, J = np.concatenate(errors), np.concatenate(rows)
            if np.abs(error).max() < 1e-12:
                return position, crank
            J = np.concatenate([J[:, :3], J[:, 6:] @ self._expand[:, :legs]], 1)
            change = np.linalg.solve(J, error)
            position -= change[:3]
            crank[:legs] -= change[3:]
        raise ArithmeticError("the legs cannot reach the planned feet: plan a slower gait.")

    def _place(self, qpos: NDArray[np.float64]) -> None:
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_comPos(self.model, self._data)

    def _sole(self, side: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the position (3,) of a sole and its Jacobian (6, nv): linear, then angular."""
        jacobian = np.zeros((6, self.model.nv))
        sole = self._soles[side]
        mujoco.mj_jacSite(self.model, self._data, jacobian[:3], jacobian[3:], sole)
        return self._data.site_xpos[sole].copy(), jacobian

    def _fitted(self, samples: NDArray[np.float64]) -> NDArray[np.float64]:
        """Fit control points (2, 8, C) to samples (2, S, C)."""
        fitted = self._fit @ samples.reshape(2 * SAMPLES, -1)
        return fitted.reshape(2, DEGREE + 1, -1)

    def _correction(self, error: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solve d - d''/omega^2 = error for a periodic pendulum displacement d (2, S, 2) in m."""
        c = self.constants
        around = error[:, :-1].reshape(-1, 2)
        waves = np.fft.rfftfreq(len(around), 2 * c.step_time / len(around)) * 2 * np.pi
        damped = np.fft.rfft(around, axis=0) / (1 + waves**2 * c.com_height / GRAVITY)[:, None]
        found = np.fft.irfft(damped, len(around), axis=0).reshape(2, SAMPLES - 1, 2)
        return np.concatenate([found, found[::-1, :1]], 1)


def _flow(omega: float, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return transition matrices (S, 2, 2) of a pendulum's position and velocity over t (S,)."""
    cosh, sinh = np.cosh(omega * t), np.sinh(omega * t)
    rows = [np.stack([cosh, sinh / omega], -1), np.stack([omega * sinh, cosh], -1)]
    return np.stack(rows, -2)


def _smooth_fit(s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix (16, 2 S) from samples of two steps to the control points of both.

    It solves least squares with exact end points and continuous velocity between steps.
    """
    n, S = DEGREE + 1, len(s)
    weights = np.kron(np.eye(2), bernstein(s))
    ends, sampled = np.zeros((4, 2 * n)), np.zeros((4, 2 * S))
    for row, (phase, last) in enumerate((p, last) for p in (0, 1) for last in (0, 1)):
        ends[row, phase * n + last * DEGREE] = 1
        sampled[row, phase * S + last * (S - 1)] = 1
    slopes = np.zeros((2, 2 * n))
    for phase in (0, 1):
        slopes[phase, phase * n + DEGREE - 1 : phase * n + n] = -1, 1
        slopes[phase, (1 - phase) * n : (1 - phase) * n + 2] = 1, -1
    constraints = np.concatenate([ends, slopes])
    zeros = np.zeros((6, 6))
    system = np.block([[weights.T @ weights, constraints.T], [constraints, zeros]])
    right = np.concatenate([weights.T, sampled, np.zeros((2, 2 * S))])
    return np.asarray(np.linalg.solve(system, right)[: 2 * n], np.float64)
