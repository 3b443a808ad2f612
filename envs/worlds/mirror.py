"""Left and right: how a robot's numbers change when it is seen in a mirror, and whether they do.

The mirror flips y: a position or velocity (x, y, z) becomes (x, -y, z), and an axial vector, such
as the axis of a rotation, (-x, y, -z). `check` compares a model's numbers and accelerations.
`find_mirror` also simulates the robot beside its image, which tells how observations are mirrored.
"""

import copy
import re
from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import Any, NamedTuple, Self

import mujoco
import numpy as np
import torch
from mujoco import mjtGeom, mjtJoint
from torch import Tensor

from ..errors import MorlaxError

FLIP = np.array([1.0, -1.0, 1.0])  # of positions and velocities
NEAR, PARALLEL = 0.01, 0.99  # meters between partners; cosine of the angle between their axes

ROUNDING = 1e-5  # relative difference of numbers that an MJCF means to be equal
SMALLEST = 1e-3  # numbers below this share of the largest one are rounded as if they were as large
NAMED = 4  # differences in an error
SKIPPED = re.compile(  # ends of fields that follow from others, are compared apart or move nothing
    "(adr|id|num|M0|acc0|weight0|length0?|lengthrange|user|plugin|group|sameframe|rgba|castshadow|"
    "aabb|rbound|pos|quat|axis|size|jnt_type|geom_type|gear|gainprm|biasprm|ctrlspec|signature)$"
)
UNKNOWN = mjtGeom.mjGEOM_HFIELD, mjtGeom.mjGEOM_SDF  # shapes that are not compared

PAIRS, STEPS = 32, 40  # robots beside their images; control steps, in which most of them fall
SETTLE = 10  # of these steps, after which observations that hold earlier states are compared
SPREAD = 0.2  # of the start, in m, rad, m/s and rad/s
# Shares of their size by which rewards and observations of robot and image may differ, in the mean
# and in the median, and what is added. MuJoCo finds contacts of meshes one after another, and its
# PGS solver finds forces so, in another order for an image.
EXACT, USUAL, TINY = 0.01, 1e-4, 1e-7
ALIKE, ALMOST = 0.1, 0.3  # in the mean, of rewards and observations, where a tolerance is given

POSES, ACCELERATION = 8, 1e-4  # random states, and the share by which accelerations may differ

Array = np.ndarray
Pairs = tuple[str, Array, Array]  # a kind of things, their rows (n,) and their partners' (n,)


class Reflection(NamedTuple):
    """A mirror's effect on S features: the i-th becomes sign[i] times the order[i]-th."""

    order: Tensor  # (S,) int64
    sign: Tensor  # (S,) 1 or -1

    @classmethod
    def of(cls, order: Sequence[int], sign: Sequence[float]) -> Self:
        """Make a reflection of lists."""
        return cls(torch.tensor(order, dtype=torch.int64), torch.tensor(sign, dtype=torch.float32))

    @classmethod
    def none(cls, size: int) -> Self:
        """Make the reflection of features that a mirror does not change."""
        return cls(torch.arange(size), torch.ones(size, dtype=torch.float32))

    @classmethod
    def joined(cls, parts: Iterable[Self]) -> Self:
        """Join the reflections of features in a row."""
        orders, signs = zip(*parts, strict=True)
        starts = accumulate(map(len, orders), initial=0)
        moved = [order + start for order, start in zip(orders, starts, strict=False)]
        return cls(torch.cat(moved), torch.cat(signs))

    def first(self, size: int) -> Self:
        """Return the reflection of the first features alone."""
        return self._replace(order=self.order[:size], sign=self.sign[:size])

    def __call__(self, features: Tensor) -> Tensor:
        """Reflect features (..., S)."""
        return features.index_select(-1, self.order) * self.sign


class Mirror(NamedTuple):
    """The reflections of a left-right symmetric robot."""

    observation: Reflection  # of the O + P features that critics see
    action: Reflection  # of the A numbers


def checked(mirror: Any, worlds: Any) -> Mirror:
    """Return a task's mirror, if every number seen in it twice is what it was."""
    (seen, acted), O, A = mirror, worlds.observation_size, worlds.action_size
    for (order, sign), size, what in (
        (seen, O + worlds.privileged_size, "observation"),
        (seen.first(O), O, "observation"),
        (acted, A, "action"),
    ):
        partners, numbers = order.tolist(), [*range(size)]
        whole = sorted(partners) == numbers and [partners[k] for k in partners] == numbers
        if not whole or not (sign * sign[order] == 1).all():
            raise MorlaxError(
                f"{type(worlds).__name__}.mirror() is wrong: mirrored twice, each of the {size} "
                f"numbers of an {what} must be what it was."
            )
    return Mirror(seen, acted)


class Motion(NamedTuple):
    """The reflections of a model's state and control."""

    positions: Reflection  # of qpos
    velocities: Reflection  # of qvel
    motors: Reflection  # of ctrl


def _cannot(reason: str) -> MorlaxError:
    return MorlaxError(
        f"this robot cannot be symmetric, since {reason}: set network.symmetric to false, or "
        "override `mirror` in the task."
    )


def check(model: mujoco.MjModel, tolerance: float = 0.0, *, scene: bool = True) -> Motion:
    """Return the reflections of a left-right symmetric model's state and control.

    Numbers may differ by `tolerance`, a share of the largest such number of the robot; 0 accepts
    only rounding. `scene`: whether to compare geoms that cannot move, too.
    """
    motion = reflections(model)
    shares = sorted(_Comparison(model, motion, scene).shares, key=lambda each: -each[0])
    if differences := [each for each in shares if each[0] > tolerance]:
        words = "; ".join(words for _, words in differences[:NAMED])
        words += f"; and {len(differences) - NAMED} more" if len(differences) > NAMED else ""
        most = np.ceil(differences[0][0] * 1000) / 1000
        accept = f", or accept this: --network.symmetry-tolerance {most:g}" if most <= 1 else ""
        advice = f"set network.symmetric to false{accept}"
        raise MorlaxError(f"left and right of this robot differ ({words}): {advice}.")
    _check_accelerations(model, motion, tolerance)
    return motion


def posed(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the pose in which left and right are compared; free bodies stand in a row."""
    data = mujoco.MjData(model)
    for k, start in enumerate(model.jnt_qposadr[model.jnt_type == mjtJoint.mjJNT_FREE]):
        data.qpos[start : start + 7] = 100.0 * k, 0, 0, 1, 0, 0, 0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def partners(positions: Array, names: Sequence[str], barred: Array | float = 0.0) -> list[int]:
    """Return the partner of each of n things: what is at its mirrored place, itself if need be.

    `positions` (n, 3) in m, as `posed`; `barred` (n, n) bool: which two cannot be partners.
    """
    apart = np.linalg.norm(positions[:, None] * FLIP - positions, axis=-1) + NEAR * barred
    order = (apart + NEAR / 1000 * np.eye(len(positions))).argmin(1)
    for i, k in enumerate(order):
        if order[k] != i or apart[i, k] >= NEAR:
            raise MorlaxError(
                f"{names[i]} has no mirrored partner on the robot, whose left and right are those "
                "of y = 0: set network.symmetric to false."
            )
    return order.tolist()


def reflections(model: mujoco.MjModel) -> Motion:
    """Return the reflections of a model's state and control; it compares only joints."""
    data = posed(model)
    if (model.jnt_type == mjtJoint.mjJNT_BALL).any():
        raise _cannot("it has ball joints, whose mirror image is not known")
    joints = np.flatnonzero(model.jnt_type >= int(mjtJoint.mjJNT_SLIDE))
    slides = model.jnt_type[joints, None] == mjtJoint.mjJNT_SLIDE
    axes = data.xaxis[joints]
    alike = axes * np.where(slides, FLIP, -FLIP) @ axes.T  # cosines, by which axes are mirrored
    barred = (abs(alike) < PARALLEL) | (slides != slides.T)
    order = partners(data.xanchor[joints], [model.joint(i).name for i in joints], barred)
    sign = torch.from_numpy(np.sign(alike[range(len(order)), order])).float()
    positions, velocities = Reflection.none(model.nq), Reflection.none(model.nv)
    free = model.jnt_type == mjtJoint.mjJNT_FREE
    for start, dof in zip(model.jnt_qposadr[free], model.jnt_dofadr[free], strict=True):
        positions.sign[start : start + 7] = torch.tensor([*FLIP, 1.0, *-FLIP])
        velocities.sign[dof : dof + 6] = torch.tensor([*FLIP, *-FLIP])
    for reflection, addresses in ((positions, model.jnt_qposadr), (velocities, model.jnt_dofadr)):
        rows = torch.from_numpy(addresses[joints]).long()
        reflection.order[rows], reflection.sign[rows] = rows[order], sign

    if len(model.actuator_trntype) != model.nu or model.actuator_trntype.any():  # 0: of a joint
        raise _cannot("it has actuators that do not move one joint")
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]].tolist()
    motors = [(dof, dofs[:i].count(dof)) for i, dof in enumerate(dofs)]  # several may move a joint
    images = [(int(velocities.order[dof]), number) for dof, number in motors]
    if not set(images) <= set(motors):
        raise _cannot("a joint without a motor mirrors one with a motor")
    order, gear = [motors.index(image) for image in images], np.sign(model.actuator_gear[:, 0])
    signs = velocities.sign[dofs].numpy() * gear * gear[order]
    return Motion(positions, velocities, Reflection.of(order, signs))


class _Comparison:
    """The numbers of bodies, geoms, joints and motors against those of their partners."""

    def __init__(self, model: mujoco.MjModel, motion: Motion, scene: bool):
        # Differences, as shares of the largest such number of the robot or of its size, in words.
        self.shares: list[tuple[float, str]] = []
        self._model, self._data = model, posed(model)
        partner = model.dof_jntid[motion.velocities.order.numpy()[model.jnt_dofadr]]
        links = {0: 0}  # of bodies that move together, their partners; 0 are those that cannot move
        homes = model.body_weldid[model.jnt_bodyid]
        for link, image in zip(homes.tolist(), homes[partner].tolist(), strict=True):
            if links.setdefault(link, image) != image:
                raise _cannot(f"{model.body(link).name} mirrors two bodies")
        moving = {link: image for link, image in links.items() if link}
        coms, roots = self._data.subtree_com, model.body_rootid[[*moving]]
        sizes = np.linalg.norm(coms[[*moving]] - coms[roots], axis=1)
        self._size = float(sizes.max(initial=0.0)) or 1.0  # of the robot, in m
        self._masses(moving)
        self._geoms(links if scene else moving)
        self._joints(partner, motion.velocities)
        self._motors(motion.motors)
        for name in ("gravity", "wind"):
            if abs(sideways := getattr(model.opt, name)[1]) > ROUNDING:
                self.shares.append((np.inf, f"{name} points to one side: {sideways:g}"))

    def _name(self, kind: str, row: int) -> str:
        body = self._model.geom_bodyid[row] if kind == "geom" else 0
        home = f" of {self._name('body', body)}" if body else ""
        return getattr(self._model, kind)(row).name or f"{kind} {row}{home}"

    def _compare(
        self, field: str, pairs: Pairs, values: Array, mirrored: Array, scale: Any = None
    ) -> None:
        """Compare values (all, c) of things with the mirrored ones of their partners, (all, c)."""
        # Differences are shares of the largest number of the scale, (all, 1), or of a column.
        kind, rows, images = pairs
        if not len(rows):
            return
        here = values.reshape(len(values), -1)[rows].astype(float)
        image = mirrored.reshape(len(mirrored), -1)[images].astype(float)
        apart, sizes = abs(here - image), np.maximum(abs(here), abs(image))
        largest = sizes.max(0)
        if scale is None:
            scale = SMALLEST * largest
        else:
            scale = np.broadcast_to(scale, (len(values), 1))[rows]
            largest = scale.max()
        far = apart > ROUNDING * np.maximum(sizes, scale)
        shares = np.where(far, apart / np.maximum(largest, 1e-300), 0.0)
        for i in np.flatnonzero(far.any(1)).tolist():
            k = int(shares[i].argmax())
            other = "its mirror image" if rows[i] == images[i] else self._name(kind, images[i])
            words = f"{field} of {self._name(kind, rows[i])} {here[i, k]:.6g}, of {other} "
            self.shares.append((float(shares[i, k]), f"{words}{image[i, k]:.6g}"))

    def _fields(self, prefix: str, pairs: Pairs, signs: Any = 1.0, rows: Any = slice(None)) -> None:
        """Compare all other numbers of things: `rows` of the fields that start with `prefix`."""
        for field in dir(self._model):
            values = getattr(self._model, field, None) if field.startswith(f"{prefix}_") else None
            if not isinstance(values, np.ndarray) or SKIPPED.search(field):
                continue
            values = mirrored = values[rows]
            if field.endswith("range"):  # turned by opposite signs; not all limits have effect
                limited = getattr(self._model, field.replace("range", "limited"))[:, None]
                values = np.where(limited, values, 0.0)
                mirrored = np.where(signs < 0, -values[:, ::-1], values)
            self._compare(field, pairs, values, mirrored)

    def _masses(self, links: dict[int, int]) -> None:
        """Compare links: bodies that move together."""
        model, data = self._model, self._data
        once = [pair for pair in links.items() if pair[0] <= pair[1]]
        rows, partners = np.array(once, int).reshape(-1, 2).T
        pairs = "body", rows, partners
        inertias = np.zeros((model.nbody, 10))
        np.add.at(inertias, model.body_weldid, data.cinert)  # xx, yy, zz, xy, xz, yz; m r; m
        inertia, moment, mass = np.split(inertias, [6, 9], 1)
        arms = moment / np.maximum(mass, 1e-300)  # from the center of mass of the robot
        center = data.subtree_com[model.body_rootid] + arms
        outer = arms[:, :, None] * moment[:, None]
        shift = outer.trace(axis1=1, axis2=2)[:, None, None] * np.eye(3) - outer
        inertia = inertia - shift[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]  # about its own center
        norms = abs(inertia).max(1, keepdims=True)
        self._compare("mass", pairs, mass, mass)
        self._compare("center of mass", pairs, center, center * FLIP, self._size)
        self._compare("inertia", pairs, inertia, inertia * [1, 1, 1, -1, 1, -1], norms)

    def _geoms(self, links: dict[int, int]) -> None:
        """Compare geoms that can touch others, each with the nearest one to its mirror image."""
        from scipy.optimize import linear_sum_assignment  # which few runs need

        model, homes = self._model, self._model.body_weldid[self._model.geom_bodyid]
        touching = (model.geom_contype | model.geom_conaffinity) > 0
        touching[[*model.pair_geom1, *model.pair_geom2]] = True
        touching &= ~np.isin(model.geom_type, UNKNOWN) & np.isin(homes, [*links])
        rows, kinds, homes = np.flatnonzero(touching), model.geom_type[touching], homes[touching]
        shapes = np.array([self._shape(geom) for geom in range(model.ngeom)]).reshape(-1, 12)
        mirrored = shapes * np.concatenate([FLIP, np.outer(FLIP, FLIP).ravel()])
        apart = np.linalg.norm(shapes[rows, None] - mirrored[rows], axis=-1)
        images = np.array([links[home] for home in homes.tolist()], int)
        unlike = (images[:, None] != homes) | (kinds[:, None] != kinds)
        numbers, order = linear_sum_assignment(np.where(unlike, 1e9, apart))
        alone = unlike[numbers, order]
        for geom in rows[alone].tolist():
            self.shares.append((np.inf, f"{self._name('geom', geom)} has no mirrored partner"))
        once = ~alone & ((numbers <= order) | (order[order] != numbers))
        pairs = "geom", rows[once], rows[order[once]]
        self._compare("position", pairs, shapes[:, :3], mirrored[:, :3], self._size)
        self._compare("size or direction", pairs, shapes[:, 3:], mirrored[:, 3:], self._size)
        self._fields("geom", pairs)

    def _shape(self, geom: int) -> Array:
        """Return a geom's center (3,), and a matrix (9,) that stretches a cube or ball to it."""
        model, turn = self._model, self._data.geom_xmat[geom].reshape(3, 3)
        center, extents = self._data.geom_xpos[geom], model.geom_aabb[geom, 3:]
        if model.geom_type[geom] == mjtGeom.mjGEOM_PLANE:
            center, extents = turn[:, 2] * (turn[:, 2] @ center), np.array([0.0, 0.0, 1.0])
        if model.geom_type[geom] == mjtGeom.mjGEOM_MESH:  # sides may have other vertices: its box
            mesh = model.mesh(model.geom_dataid[geom])
            vertices = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]] @ turn.T
            low, high = vertices.min(0), vertices.max(0)
            center, turn, extents = center + (low + high) / 2, np.eye(3), (high - low) / 2
        return np.concatenate([center, (turn * extents @ turn.T).ravel()])

    def _joints(self, partner: Array, velocities: Reflection) -> None:
        """Compare joints of one degree of freedom; hinges by the lines that they turn around."""
        model, data = self._model, self._data
        dofs, slides = model.jnt_dofadr, model.jnt_type[:, None] == mjtJoint.mjJNT_SLIDE
        single = model.jnt_type >= int(mjtJoint.mjJNT_SLIDE)
        joints = np.flatnonzero(single & (np.arange(model.njnt) <= partner))
        pairs, axes = ("joint", joints, partner[joints]), data.xaxis
        signs = velocities.sign.double().numpy()[dofs, None]
        arms = data.xanchor - data.subtree_com[model.body_rootid[model.jnt_bodyid]]
        moments = np.where(slides, 0.0, np.cross(arms, axes))
        self._compare("axis", pairs, axes, np.where(slides, FLIP, -FLIP) * axes * signs, 1.0)
        self._compare("position", pairs, moments, FLIP * moments * signs, self._size)
        for field in ("qpos0", "qpos_spring"):
            values = getattr(model, field)[model.jnt_qposadr, None]
            self._compare(field, pairs, values, values * signs)
        self._fields("jnt", pairs, signs)
        self._fields("dof", pairs, rows=dofs)

    def _motors(self, motors: Reflection) -> None:
        model, order, signs = self._model, motors.order.numpy(), motors.sign.numpy()[:, None]
        rows = np.flatnonzero(np.arange(model.nu) <= order)
        pairs, gear = ("actuator", rows, order[rows]), abs(model.actuator_gear[:, 0])
        # force = (gain + gain length + gain velocity) ctrl + bias + bias length + bias velocity
        for field, turned in (("actuator_gainprm", [0, 1, 1]), ("actuator_biasprm", [1, 0, 0])):
            values = getattr(model, field)[:, :3]
            self._compare(field, pairs, values, values * signs**turned)
        self._compare("actuator_gear", pairs, gear, gear)
        self._fields("actuator", pairs, signs)


def _check_accelerations(model: mujoco.MjModel, motion: Motion, tolerance: float) -> None:
    """Refuse robots of which a joint accelerates unlike its mirror image in a random state.

    With a tolerance, only what tendons and constraints add to accelerations is compared.
    """
    if tolerance and not (model.ntendon or model.neq):
        return
    bound = copy.copy(model)
    bound.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    bound.opt.solver, bound.opt.iterations = mujoco.mjtSolver.mjSOL_NEWTON, 200
    bound.opt.tolerance, bound.opt.noslip_iterations = 1e-12, 0
    bound.jnt_limited[:] = False  # ranges have been compared
    loose, data, random = copy.copy(bound), mujoco.MjData(bound), np.random.default_rng(0)
    loose.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    for field in ("stiffness", "damping", "frictionloss", "armature", "limited"):
        getattr(loose, f"tendon_{field}")[:] = 0

    def accelerations(*state: Array) -> Array:
        total = np.zeros(model.nv)
        for robot, sign in ((bound, 1.0), (loose, -1.0 if tolerance else 0.0)):
            mujoco.mj_resetData(robot, data)
            data.qpos[:], data.qvel[:], data.ctrl[:] = state
            mujoco.mj_forward(robot, data)
            total += sign * data.qacc
        return total

    apart, sizes = np.zeros((2, model.nv))
    for _ in range(POSES):
        qpos, shift = posed(model).qpos, random.uniform(-0.3, 0.3, model.nv)
        mujoco.mj_integratePos(model, qpos, shift, 1.0)
        state = qpos, random.uniform(-1, 1, model.nv), random.uniform(-1, 1, model.nu)
        image = [turn(torch.from_numpy(x)).numpy() for turn, x in zip(motion, state, strict=True)]
        expected = motion.velocities(torch.from_numpy(accelerations(*state))).numpy()
        apart += abs(expected - accelerations(*image))
        sizes += abs(expected)
    excess = apart - (ALMOST * sizes.max() if tolerance else ACCELERATION * sizes)
    if excess.max() > 1e-9:
        joint = int(model.dof_jntid[excess.argmax()])
        raise _cannot(
            f"{model.joint(joint).name or f'joint {joint}'} and its mirror image accelerate "
            "differently, such as by a tendon or constraint that one side lacks"
        )


def find_mirror(worlds: Any, tolerance: float = 0.0) -> Mirror:
    """Return the mirror of a robot in 2 * PAIRS worlds, alike, of C MuJoCo, without resets."""
    physics, generator = worlds.physics, torch.Generator().manual_seed(0)
    motion = check(physics.model, tolerance)
    if worlds.action_size != len(motion.motors.order):
        raise _cannot("an action of it is not the control of one motor")
    if worlds.command_limits:  # a command that stays the same would not show its signs
        raise _cannot("it follows a command")

    def draw(*shape: int) -> Tensor:
        return 2 * torch.rand(*shape, generator=generator, dtype=torch.float32) - 1

    shift, speed = SPREAD * draw(2, PAIRS, physics.model.nv).to(physics.qpos)
    for start, change in zip(physics.qpos.numpy(), shift.numpy(), strict=False):
        mujoco.mj_integratePos(physics.model, start, change, 1.0)
    physics.qvel[:PAIRS] = speed
    # of a whole episode, as far as it goes: some observations change late
    ages = torch.arange(PAIRS) * max(worlds.episode_length - STEPS, 0) // PAIRS
    worlds.age.copy_(ages.repeat(2))
    seen, earned = [], []
    for _ in range(STEPS):
        action = draw(PAIRS, worlds.action_size)
        for values, reflection in (
            (physics.qpos, motion.positions),
            (physics.qvel, motion.velocities),
            (physics.warmstart, motion.velocities),
        ):
            values[PAIRS:] = reflection(values[:PAIRS])  # in each step, or chaos would part them
        step = worlds.step(torch.cat([action, motion.motors(action)]))
        seen.append(step.final_critic_observation.unflatten(0, (2, PAIRS)))
        earned.append(step.reward.unflatten(0, (2, PAIRS)))
    # (2, n, m) and (2, n, O + P): of robots and their images
    rewards, images = (torch.stack(x[SETTLE:], 1).flatten(1, 2) for x in (earned, seen))
    limit, almost = (ALIKE, ALMOST) if tolerance else (EXACT, EXACT)
    far = _far((rewards[0] - rewards[1]).abs(), rewards[0].abs().mean(0), limit)
    for name in (name for name, each in zip(worlds.objectives, far, strict=True) if each):
        raise _cannot(f"its mirror image has other rewards of the objective {name}")
    observation = _matching(images[0], images[1], almost)
    if (observation.order.diff() == 1).all() and (observation.sign > 0).all():
        raise _cannot("it has no left and right")
    return Mirror(observation, motion.motors)


def _far(apart: Tensor, size: Tensor, limit: float) -> Tensor:
    """Return (c,) bool: whether the mean of differences (n, c) exceeds a share of `size` (c,)."""
    far = apart.mean(0) > limit * size + TINY
    return far | (apart.median(0).values > USUAL * size + TINY) if limit == EXACT else far


def _matching(seen: Tensor, image: Tensor, limit: float) -> Reflection:
    """Return the reflection of features (n, S) that explains what the images saw, (n, S)."""
    seen, image = seen.double(), image.double()
    energy, product = seen.square().mean(0), image.T @ seen / len(seen)
    error = image.square().mean(0)[:, None] + energy - 2 * product.abs()  # of the better sign
    error.diagonal().sub_(1e-9 * (1 + energy))  # what is always zero, or the same, stays in place
    error = error + error.T
    order, rows = torch.full_like(energy, -1).long(), torch.arange(len(energy))
    for row in rows.tolist():
        if order[row] < 0:  # of several that are always equal, each gets one
            partner = int(error[row].masked_fill(order >= 0, torch.inf).argmin())
            order[row], order[partner] = partner, row
    sign = torch.where(product[rows, order] < 0, -1.0, 1.0).float()
    far = _far((image - seen[:, order] * sign).abs(), energy[order].sqrt(), limit)
    if far.any():
        raise _cannot(f"number {int(far.int().argmax())} of its observation has no mirror image")
    return Reflection(order, sign)
