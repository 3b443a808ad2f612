"""Score a policy of the G1 in C MuJoCo by the rules of the public teleop-walking-benchmark.

A crane lets go of the robot, which has 5 s for each of 18 waypoints. Its arms go to targets that
walk at random, and a punch hits it in each segment. The 3 s in the crane are left out: the base is
put back in every physics step, so no weight moves a joint from the default pose. The robot is
mjlab's G1 with the benchmark's friction and torque of hips; run ids draw other numbers than there.
"""

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import copy
from functools import cache, partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...envs import MorlaxError
from ...envs.bridges.mjlab import tour_rules as rules
from ...host.phases import phase
from .episodes import Policy
from .robot import Array, Export, Robot, open_export

POINTS, JOINTS = 18, 29  # waypoints; joints that punches hit
WALK = POINTS * rules.SEGMENT  # s
CENTER, RADIUS = np.array([0.3, 0.0]), 1.0  # m, of the disk of waypoints
ENTER, LEAVE = np.array([0.1, 0.05]), np.array([0.2, 0.12])  # m, rad: reached below, until above
TRIES = 8  # to find a target where hands may be
HEIGHT, LOWEST = 0.793, 0.2  # m of the base when the crane lets go, and when the robot fell
TIMESTEP = 0.002  # s
FRICTION = 1.0  # sliding
MESHES = "left_rubber_hand", "right_rubber_hand", "head_link"
CORNERS = np.array(list(product((-1, 1), repeat=3)))  # of a box
ENOUGH = 0.2  # smallest share of completed runs that has a mean


class Run(NamedTuple):
    """The outcome of a run; errors are means over its waypoints."""

    seconds: float  # until the fall, if there was one
    completed: bool
    position: float  # cm
    yaw: float  # degrees
    energy: float  # kJ
    vibration: float  # 1e6 rad/s^2


class Walker(Robot):
    """A robot whose joints are torque servos, and whose arms are not the policy's."""

    def __init__(self, deployment: Export):
        settings, model = deployment.settings, copy(deployment.model)
        model.opt.timestep, model.geom_friction[:, 0] = TIMESTEP, FRICTION
        super().__init__(deployment._replace(model=model))
        model = self.model
        prefix = settings.joints[0].rpartition("/")[0] + "/"
        names = [name.removeprefix(prefix) for name in settings.joints]
        self._arms = [names.index(name) for name in rules.ARMS if name in names]
        if len(self._arms) < len(rules.ARMS) or {*self._arms} & {*self._driven}:
            raise MorlaxError(
                "a tour is for policies that own the legs and the waist of a G1, and not its arms: "
                f"train mjlab:{rules.TASK}."
            )
        moved = model.actuator_trnid[:, 0].tolist()
        self._servos = [moved.index(joint) for joint in self._joints]
        model.actuator_gainprm[:, 0], model.actuator_biasprm[:] = 1, 0  # `walk` has the gains
        self._stiffness, self._damping = np.array(settings.stiffness), np.array(settings.damping)
        self._targets = self._rest[0].copy()  # rad
        self.data.qpos[self._height] = HEIGHT
        mujoco.mj_forward(model, self.data)
        self._shown = mujoco.MjData(model)  # of arms that are tried
        self._shown.qpos[self._qpos] = self._rest[0]
        self._torso = model.body(f"{prefix}torso_link").id
        meshes = [model.mesh(f"{prefix}{name}").id for name in MESHES]
        *self._hands, head = (model.geom_dataid.tolist().index(mesh) for mesh in meshes)
        mujoco.mj_kinematics(model, self._shown)
        self._front = self._corners(*self._hands)[:, 0].min()
        self._top = self._corners(head)[:, 2].min()

    def walk(self, action: Array, left: Array, hit: int, force: Array) -> tuple[Array, Array]:
        """Take a control step; return the torques (J,) and speeds (J,) of joints at its beginning.

        The left arm gets targets (7,) in rad, the right one mirrors them, and a force (3,) in N
        pushes at the joint `hit`.
        """
        self.action = action
        self._targets[self._driven] = (self._offset + self._scale * action).clip(*self._clip)
        self._targets[self._arms] = [*left, *left * rules.MIRROR]
        model, data, joint, costs = self.model, self.data, self._joints[hit], []
        for _ in range(self._substeps):
            error, speed = self._targets - data.qpos[self._qpos], data.qvel[self._qvel]
            data.ctrl[self._servos] = self._stiffness * error - self._damping * speed
            data.qfrc_applied[:] = 0
            if force.any():
                at, body, none = data.xanchor[joint], model.jnt_bodyid[joint], np.zeros(3)
                mujoco.mj_applyFT(model, data, force, none, at, body, data.qfrc_applied)
            mujoco.mj_step(model, data)
            costs.append((data.qfrc_actuator[self._qvel], data.qvel[self._qvel]))
        return costs[0]

    def pose(self) -> tuple[Array, float]:
        """Return the position (3,) of the base in m, and its heading in rad."""
        (x, *_), (y, *_), _ = self._turn()
        return self.data.xpos[self.base], math.atan2(y, x)

    def arms(self, rng: np.random.Generator) -> Iterator[Array]:
        """Yield targets (7,) of the left arm, one per control step, in rad."""
        left, steps = self._arms[: len(rules.ARM)], round(rules.WINDOW / self.dt)
        ranges = self.model.jnt_range[[self._joints[index] for index in left]]
        after = self._rest[0][left]
        while True:
            before = after
            for _ in range(TRIES):
                wish = before
                for change in rng.uniform(-rules.WANDER, rules.WANDER, (steps, len(left))):
                    wish = (wish + change).clip(*ranges.T)
                if self._fits(wish):
                    after = wish
                    break
            yield from np.linspace(before, after, steps + 1)[1:]

    def _fits(self, left: Array) -> bool:
        """Return whether hands are before their place in the default pose, and below the head."""
        self._shown.qpos[self._qpos[self._arms]] = [*left, *left * rules.MIRROR]
        mujoco.mj_kinematics(self.model, self._shown)
        x, _, z = self._corners(*self._hands).T
        return bool(x.min() >= self._front and z.max() <= self._top)

    def _corners(self, *geoms: int) -> Array:
        """Return corners (8 G, 3) of the boxes around geoms in the torso's frame, in m."""
        data, rows = self._shown, []
        for geom in geoms:
            center, half = self.model.geom_aabb[geom].reshape(2, 3)
            turn = data.geom_xmat[geom].reshape(3, 3)
            rows.append(data.geom_xpos[geom] + (center + half * CORNERS) @ turn.T)
        torso = data.xmat[self._torso].reshape(3, 3)
        return (np.concatenate(rows) - data.xpos[self._torso]) @ torso


def plan(rng: np.random.Generator) -> tuple[Array, NDArray[np.int64], Array]:
    """Draw waypoints (P, 3) in m, m, rad, joints (P,) that are hit, and forces (P, 3) in N."""
    radius, bearing = RADIUS * np.sqrt(rng.random(POINTS)), rng.uniform(0, math.tau, POINTS)
    places = CENTER + radius[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], 1)
    points = np.column_stack([places, rng.uniform(-math.pi, math.pi, POINTS)])
    climbed = np.minimum(np.arange(POINTS) * rules.SEGMENT / rules.RAMP, 1)
    sizes = rules.strongest(climbed) * rng.uniform(rules.LIGHTEST, 1, POINTS)
    forces = rng.standard_normal((POINTS, 3))
    forces *= (sizes / np.linalg.norm(forces, axis=1))[:, None]
    return points, rng.integers(JOINTS, size=POINTS), forces


def command(error: Array, reached: NDArray[np.bool_], limits: Array) -> Array:
    """Return the command (3,) within limits (3, 2) for an error (3,) in m ahead, m left, rad.

    It updates whether the position and the heading are `reached` (2,).
    """
    sizes = np.array([np.hypot(*error[:2]), abs(error[2])])
    reached[:] = sizes < np.where(reached, LEAVE, ENTER)
    return (rules.GAIN * error * ~reached[[0, 0, 1]]).clip(*limits.T)


def costs(torques: Array, speeds: Array, dt: float) -> tuple[float, float]:
    """Return energy (kJ) and vibration (1e6 rad/s^2) for torques and speeds (T, J) of joints."""
    acceleration = np.diff(speeds, axis=0, prepend=0) / dt
    vibration = np.abs(np.diff(acceleration, axis=0, prepend=0)).sum()
    return float(np.abs(torques * speeds).sum() * dt / 1e3), float(vibration / 1e6)


def tour(deployment: Export, policy: Policy, run_id: int, seconds: float = WALK) -> Run:
    """Let a policy walk the tour of a run id, or its first seconds."""
    robot, rng = Walker(deployment), np.random.default_rng(run_id)
    points, joints, forces = plan(rng)
    arms, limits = robot.arms(rng), np.array(deployment.settings.limits)
    times = rules.SEGMENT, rules.DELAY, rules.DELAY + rules.DURATION
    segment, begin, end = (round(time / robot.dt) for time in times)
    reached, errors, rows, fallen = np.zeros(2, bool), [], [], False
    for step in range(round(seconds / robot.dt)):
        index, since = divmod(step, segment)
        position, heading = robot.pose()
        if fallen := position[2] < LOWEST or robot.broken():
            break
        x, y = points[index, :2] - position[:2]
        cos, sin = math.cos(heading), math.sin(heading)
        yaw = math.remainder(points[index, 2] - heading, math.tau)
        errors.append((100 * math.hypot(x, y), math.degrees(abs(yaw))))
        reached &= since > 0
        error = np.array([cos * x + sin * y, cos * y - sin * x, yaw])
        action = policy.act(robot.observe(command(error, reached, limits)))
        force = forces[index] if begin <= since < end else np.zeros(3)
        rows.append(robot.walk(action, next(arms), joints[index], force))
    distance, yaw = np.mean([*errors[segment - 1 : -1 : segment], errors[-1]], 0).tolist()
    torques, speeds = np.array(rows).swapaxes(0, 1)
    energy, vibration = costs(torques, speeds, robot.dt)
    return Run(len(rows) * robot.dt, not fallen, distance, yaw, energy, vibration)


def score(
    path: Path,
    runs: int,
    tradeoff: Sequence[float] | None = None,
    seconds: float = WALK,
    first: int = 0,
) -> dict[str, float]:
    """Return the columns of the table for an export, after the run ids from `first` on.

    Energy and vibration are means of completed runs, nan if few are completed; those "of all" also
    count runs that end with a fall, per duration of a completed run. `tradeoff` (m,) need not sum
    to one (None: the same for all objectives).
    """
    deployment, rows = open_export(path), []
    if not deployment.settings.step_dt <= seconds <= WALK or runs < 1:
        raise MorlaxError(f"--tour-runs must be at least 1, and --seconds at most {WALK:g}.")
    Walker(deployment)  # or an error
    if tradeoff is not None and not Policy(deployment).slides:
        raise MorlaxError(f"{path} has a fixed trade-off: leave --tradeoff out.")
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as processes:
        ids = range(first, first + runs)
        for row in processes.map(partial(_run, path, tradeoff, seconds), ids):
            rows.append(row)
            phase("touring", len(rows) / runs)
    table = np.array(rows)
    survival, share, position, yaw, *of_all = table.mean(0)
    done = table[table[:, 1] > 0, 4:].mean(0) if share >= ENOUGH else [math.nan] * 2
    of_all = np.array(of_all) * seconds / survival
    heads = (
        *("survival (s)", "completed (%)", "position error (cm)", "yaw error (deg)"),
        *("walk energy (kJ)", "vibration (1e6 rad/s^2)"),
        *("energy of all (kJ)", "vibration of all (1e6 rad/s^2)"),
    )
    values = survival, 100 * share, position, yaw, *done, *of_all
    return {head: float(value) for head, value in zip(heads, values, strict=True)}


@cache
def _open(path: Path) -> tuple[Export, Policy]:
    deployment = open_export(path)
    return deployment, Policy(deployment)


def _run(path: Path, tradeoff: Sequence[float] | None, seconds: float, run_id: int) -> Run:
    deployment, policy = _open(path)
    if tradeoff is not None:
        policy.choose(np.array(tradeoff) / sum(tradeoff), at_once=True)
    return tour(deployment, policy, run_id, seconds)
