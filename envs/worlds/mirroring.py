"""Find the mirror of a robot whose left and right are alike.

`check` compares the numbers of a model, which tell how joints and motors are mirrored.
`find_mirror` also simulates the robot beside its mirror image: what both observe tells how
observations are mirrored, so that tasks need not declare it.
"""

import copy
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import torch
from mujoco import mjtGeom, mjtJoint
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ..errors import MorlaxError
from .mirror import Mirror, Reflection

FLIP = np.array([1.0, -1.0, 1.0])  # of positions and velocities
NEAR, PARALLEL = 0.01, 0.99  # meters between partners; cosine of the angle between their axes

ROUNDING = 1e-5  # relative difference of numbers that an MJCF means to be equal
SMALLEST = 1e-3  # numbers below this share of the largest one are rounded as if they were as large
POSES, ACCELERATION = 8, 1e-4  # random states, and the relative difference of accelerations there
NAMED = 4  # differences in an error
SKIPPED = re.compile(  # ends of fields that follow from others, are compared apart or move nothing
    "(adr|id|num|M0|acc0|weight0|length0?|lengthrange|user|plugin|group|sameframe|rgba|castshadow|"
    "aabb|rbound|pos|quat|axis|size|jnt_type|geom_type|gear|gainprm|biasprm|ctrlspec|signature)$"
)
ROUND = mjtGeom.mjGEOM_SPHERE, mjtGeom.mjGEOM_CAPSULE, mjtGeom.mjGEOM_CYLINDER
UNKNOWN = mjtGeom.mjGEOM_HFIELD, mjtGeom.mjGEOM_SDF  # shapes that are not compared

PAIRS, STEPS = 32, 40  # robots beside their images; control steps, in which most of them fall
SETTLE = 10  # of these steps, after which observations that hold earlier states are compared
SPREAD = 0.2  # of the start, in m, rad, m/s and rad/s
# Shares of their size by which rewards and observations of robot and image may differ, in the mean
# and in the median, and what is added. MuJoCo finds contacts of meshes one after another, and its
# PGS solver finds forces so, in another order for an image.
EXACT, USUAL, TINY = 0.01, 1e-4, 1e-7
ALIKE, ALMOST = 0.1, 0.3  # in the mean, of rewards and observations, where a tolerance is given

Array = NDArray[np.float64]
Pairs = Sequence[Sequence[str]]  # names of n things, and of their n partners


class Motion(NamedTuple):
    """The reflections of a model's state and control."""

    positions: Reflection  # of qpos
    velocities: Reflection  # of qvel
    motors: Reflection  # of ctrl


class Difference(NamedTuple):
    """A number of one side that is not that of the other side."""

    words: str
    share: float  # of the largest such number of the robot, or of the robot's size


def _cannot(reason: str) -> MorlaxError:
    return MorlaxError(
        f"this robot cannot be symmetric, since {reason}: set network.symmetric to false, or "
        "override `mirror` in the task."
    )


def check(model: mujoco.MjModel, tolerance: float = 0.0, *, scene: bool = True) -> Motion:
    """Return the reflections of a model's state and control, if its left and right are alike.

    Args:
        model: the robot.
        tolerance: largest difference to accept, as a share of the largest such number of the robot;
            0 accepts only those from rounding.
        scene: whether to compare geoms that cannot move, too.

    Raises:
        MorlaxError: a joint or motor has no mirrored partner, or numbers of left and right differ.
    """
    motion = _motion(model)
    differences = [each for each in _differences(model, motion, scene) if each.share > tolerance]
    if differences:
        differences.sort(key=lambda each: -each.share)
        words = "; ".join(each.words for each in differences[:NAMED])
        words += f"; and {len(differences) - NAMED} more" if len(differences) > NAMED else ""
        most = np.ceil(differences[0].share * 1000) / 1000
        accept = f", or accept this: --network.symmetry-tolerance {most:g}" if most <= 1 else ""
        raise MorlaxError(
            f"left and right of this robot differ ({words}): set network.symmetric to false{accept}"
            "."
        )
    if not tolerance and (joint := _moves_unlike(model, motion)) is not None:
        raise _cannot(
            f"{model.joint(joint).name or f'joint {joint}'} and its mirror image accelerate "
            "differently, such as by a tendon or constraint that one side lacks"
        )
    return motion


def posed(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the pose in which left and right are compared; free bodies stand in a row."""
    data = mujoco.MjData(model)
    for k, start in enumerate(model.jnt_qposadr[model.jnt_type == mjtJoint.mjJNT_FREE]):
        data.qpos[start : start + 7] = 100.0 * k, 0, 0, 1, 0, 0, 0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def partners(positions: Array, names: Sequence[str], barred: NDArray | float = 0.0) -> list[int]:
    """Return the partner of each of n things: what is at its mirrored place, itself if need be.

    Args:
        positions: (n, 3) in m, as `posed`.
        names: for the error.
        barred: (n, n) bool, which two cannot be partners.

    Raises:
        MorlaxError: one has no partner that has it as a partner, too.
    """
    apart = np.linalg.norm(positions[:, None] * FLIP - positions, axis=-1) + NEAR * barred
    order = (apart + NEAR / 1000 * np.eye(len(positions))).argmin(1)
    for i, k in enumerate(order):
        if order[k] != i or apart[i, k] >= NEAR:
            raise MorlaxError(
                f"{names[i]} has no mirrored partner on the robot: set network.symmetric to false."
            )
    return order.tolist()


def _single(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the joints with one degree of freedom."""
    return np.flatnonzero(model.jnt_type >= int(mjtJoint.mjJNT_SLIDE))


def _slides(model: mujoco.MjModel, joints: NDArray) -> NDArray:
    """Return (n, 1) bool: which joints slide along their axis instead of turning around it."""
    return (model.jnt_type[joints] == mjtJoint.mjJNT_SLIDE)[:, None]


def _motion(model: mujoco.MjModel) -> Motion:
    data, joints = posed(model), _single(model)
    axes, slides = data.xaxis[joints], _slides(model, joints)
    alike = axes * np.where(slides, FLIP, -FLIP) @ axes.T  # cosines, by which axes are mirrored
    barred = (abs(alike) < PARALLEL) | (slides != slides.T)
    order = partners(data.xanchor[joints], [model.joint(i).name for i in joints], barred)
    sign = torch.from_numpy(np.sign(alike[range(len(order)), order])).float()
    positions, velocities = Reflection.none(model.nq), Reflection.none(model.nv)
    free = model.jnt_type == mjtJoint.mjJNT_FREE
    for start, dof in zip(model.jnt_qposadr[free], model.jnt_dofadr[free], strict=True):
        positions.sign[start : start + 7] = torch.tensor([*FLIP, 1.0, *-FLIP])
        velocities.sign[dof : dof + 6] = torch.tensor([*FLIP, *-FLIP])
    for reflection, where in ((positions, model.jnt_qposadr), (velocities, model.jnt_dofadr)):
        rows = torch.from_numpy(where[joints]).long()
        reflection.order[rows], reflection.sign[rows] = rows[order], sign
    return Motion(positions, velocities, _of_motors(model, velocities))


def _of_motors(model: mujoco.MjModel, velocities: Reflection) -> Reflection:
    """Return the reflection of ctrl, from that of qvel."""
    kinds = model.actuator_trntype
    if len(kinds) != model.nu or (kinds != mujoco.mjtTrn.mjTRN_JOINT).any():
        raise _cannot("it has actuators that do not move one joint")
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]].tolist()
    motors = [(dof, dofs[:i].count(dof)) for i, dof in enumerate(dofs)]  # several may move a joint
    images = [(int(velocities.order[dof]), number) for dof, number in motors]
    if not set(images) <= set(motors):
        raise _cannot("a joint without a motor mirrors one with a motor")
    order, gear = [motors.index(image) for image in images], np.sign(model.actuator_gear[:, 0])
    return Reflection.of(order, velocities.sign[dofs].numpy() * gear * gear[order])


def _differences(model: mujoco.MjModel, motion: Motion, scene: bool) -> Iterator[Difference]:
    """Compare the numbers of bodies, geoms, joints and motors with those of their partners."""
    data, order = posed(model), motion.velocities.order
    partner = model.dof_jntid[order[model.jnt_dofadr]] if model.njnt else np.empty(0, int)
    links = {0: 0}  # of bodies that move together, their partners; 0 are those that cannot move
    for link, image in model.body_weldid[
        model.jnt_bodyid[np.array([range(model.njnt), partner]).T]
    ]:
        if links.setdefault(int(link), int(image)) != image:
            raise _cannot(f"{model.body(link).name} mirrors two bodies")
    moving = {link: image for link, image in links.items() if link}
    centers = data.subtree_com[[*moving]] - data.subtree_com[model.body_rootid[[*moving]]]
    size = float(np.linalg.norm(centers, axis=1).max(initial=0.0)) or 1.0  # of the robot, in m
    yield from _of_masses(model, data, moving, size)
    yield from _of_geoms(model, data, links if scene else moving, size)
    yield from _of_joints(model, data, motion, partner, size)
    yield from _of_actuators(model, motion)
    for name in ("gravity", "wind"):
        if abs(sideways := getattr(model.opt, name)[1]) > ROUNDING:
            yield Difference(f"{name} points to one side: {sideways:g}", np.inf)


def _apart(
    field: str,
    names: Pairs,
    values: ArrayLike,
    images: ArrayLike,
    floor: ArrayLike | None = None,
    largest: float | None = None,
) -> Iterator[Difference]:
    """Compare values (n, c) of things with those of their mirrored partners (n, c).

    Rounding is relative to `floor`, (n, 1) or a number, if values are smaller. Differences are
    shares of `largest`, by default of the largest number of a column.
    """
    if not len(names[0]):
        return
    values, images = (np.reshape(x, (len(names[0]), -1)).astype(float) for x in (values, images))
    apart, sizes = abs(values - images), np.maximum(abs(values), abs(images))
    highest = sizes.max(0) if largest is None else np.full(values.shape[1], largest)
    far = apart > ROUNDING * np.maximum(sizes, SMALLEST * highest if floor is None else floor)
    shares = np.where(far, apart / np.maximum(highest, 1e-300), 0.0)
    for i in np.flatnonzero(far.any(1)).tolist():
        k, (name, other) = int(shares[i].argmax()), (each[i] for each in names)
        image = "its mirror image" if name == other else other
        words = f"{field} of {name} {values[i, k]:.6g}, of {image} {images[i, k]:.6g}"
        yield Difference(words, float(shares[i, k]))


def _names(look_up: Callable[[int], Any], kind: str, *groups: Sequence[int] | NDArray) -> Pairs:
    return [[look_up(i).name or f"{kind} {i}" for i in group] for group in groups]


def _of_masses(
    model: mujoco.MjModel, data: mujoco.MjData, moving: dict[int, int], size: float
) -> Iterator[Difference]:
    """Compare mass, center of mass and inertia of links: of bodies that move together."""
    pairs = [(link, image) for link, image in moving.items() if link <= image]
    links, images = np.array(pairs, int).reshape(-1, 2).T
    names = _names(model.body, "body", links, images)
    of_link = (model.body_weldid == np.arange(model.nbody)[:, None]).astype(float)  # (link, body)
    masses, turns = model.body_mass, data.ximat.reshape(-1, 3, 3)
    mass = of_link @ masses
    center = of_link @ (masses[:, None] * data.xipos) / np.maximum(mass, 1e-300)[:, None]
    arms = data.xipos - center[model.body_weldid]
    squares = (arms**2).sum(1)[:, None, None] * np.eye(3) - arms[:, :, None] * arms[:, None]
    inertias = turns * model.body_inertia[:, None] @ turns.swapaxes(1, 2)
    inertia = np.tensordot(of_link, inertias + masses[:, None, None] * squares, 1)
    norms = abs(inertia[links]).max((1, 2), initial=0.0)[:, None]
    yield from _apart("mass", names, mass[links], mass[images])
    yield from _apart("center of mass", names, center[links], center[images] * FLIP, size, size)
    mirrored = inertia[images] * np.outer(FLIP, FLIP)
    yield from _apart("inertia", names, inertia[links], mirrored, norms, norms.max(initial=0.0))


def _of_geoms(
    model: mujoco.MjModel, data: mujoco.MjData, links: dict[int, int], size: float
) -> Iterator[Difference]:
    """Compare geoms that can touch others."""
    touching = (model.geom_contype | model.geom_conaffinity) > 0
    touching[[*model.pair_geom1, *model.pair_geom2]] = True
    touching &= ~np.isin(model.geom_type, UNKNOWN)
    shapes = np.array([_shape(model, data, i) for i in range(model.ngeom)]).reshape(-1, 12)
    mirrored = shapes * np.concatenate([FLIP, np.outer(FLIP, FLIP).ravel()])
    home, pairs, alone = model.body_weldid[model.geom_bodyid], [], []
    for link, image in ((link, image) for link, image in links.items() if link <= image):
        free = np.flatnonzero(touching & (home == image)).tolist()
        for geom in np.flatnonzero(touching & (home == link)).tolist():
            same = [i for i in free if model.geom_type[i] == model.geom_type[geom]]
            if same:
                apart = np.linalg.norm(shapes[geom] - mirrored[same], axis=1)
                pairs.append((geom, same[int(apart.argmin())]))
                free.remove(pairs[-1][1])
            else:
                alone.append(geom)
        alone += free if link != image else []
    pairs = [(i, k) for i, k in pairs if i <= k or (k, i) not in pairs]
    geoms, images = np.array(pairs, int).reshape(-1, 2).T

    def name(geom: int) -> str:
        body = model.body(model.geom_bodyid[geom]).name
        return model.geom(geom).name or f"geom {geom} of {body or 'a body'}"

    for geom in alone:
        yield Difference(f"{name(geom)} has no mirrored partner", np.inf)
    names = [[name(i) for i in each] for each in (geoms, images)]
    ours, others = shapes[geoms], mirrored[images]
    yield from _apart("position", names, ours[:, :3], others[:, :3], size, size)
    yield from _apart("size or direction", names, ours[:, 3:], others[:, 3:], size, size)
    radius = np.where(np.isin(model.geom_type, ROUND), model.geom_size[:, 0], 0.0)
    yield from _apart("radius", names, radius[geoms], radius[images])
    yield from _of_fields(model, "geom", names, geoms, images)


def _shape(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    """Return a geom's center (3,), and a matrix (9,) that shows its size and direction.

    The matrix stretches a ball or cube to the geom, without the radius of capsules and cylinders.
    """
    center, turn = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    extents = model.geom_size[geom]
    match int(model.geom_type[geom]):
        case mjtGeom.mjGEOM_PLANE:
            center, extents = turn[:, 2] * (turn[:, 2] @ center), np.array([0.0, 0.0, 1.0])
        case mjtGeom.mjGEOM_CAPSULE | mjtGeom.mjGEOM_CYLINDER:
            extents = np.array([0.0, 0.0, extents[1]])
        case mjtGeom.mjGEOM_SPHERE:
            extents = np.zeros(3)
        case mjtGeom.mjGEOM_MESH:  # left and right may have other vertices: compare its box
            mesh = model.mesh(model.geom_dataid[geom])
            start, number = mesh.vertadr[0], mesh.vertnum[0]
            vertices = model.mesh_vert[start : start + number] @ turn.T
            low, high = vertices.min(0), vertices.max(0)
            center, turn, extents = center + (low + high) / 2, np.eye(3), (high - low) / 2
    return np.concatenate([center, (turn * extents @ turn.T).ravel()])


def _of_joints(
    model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, partner: NDArray, size: float
) -> Iterator[Difference]:
    joints = np.array([joint for joint in _single(model) if joint <= partner[joint]], int)
    images, slides, axes = partner[joints], _slides(model, joints), data.xaxis[joints]
    names = _names(model.joint, "joint", joints, images)
    dofs = model.jnt_dofadr[joints]
    signs = motion.velocities.sign.double().numpy()[dofs, None]
    mirrored = np.where(slides, FLIP, -FLIP) * data.xaxis[images] * signs
    yield from _apart("axis", names, axes, mirrored, 1.0, 1.0)
    shift = np.where(slides, 0.0, data.xanchor[joints] - data.xanchor[images] * FLIP)
    shift -= (shift * axes).sum(1, keepdims=True) * axes  # along the axis, it has no effect
    yield from _apart("position", names, shift, np.zeros_like(shift), size, size)
    yield from _of_fields(model, "jnt", names, joints, images, signs)
    for field in ("qpos0", "qpos_spring"):
        values = getattr(model, field)[model.jnt_qposadr, None]
        yield from _apart(field, names, values[joints], values[images] * signs)
    yield from _of_fields(model, "dof", names, dofs, model.jnt_dofadr[images])


def _of_actuators(model: mujoco.MjModel, motion: Motion) -> Iterator[Difference]:
    order = motion.motors.order.numpy()
    motors = np.flatnonzero(np.arange(model.nu) <= order)
    images, signs = order[motors], motion.motors.sign.double().numpy()[motors, None]
    names = _names(model.actuator, "motor", motors, images)
    # force = (gain + gain length + gain velocity) ctrl + bias + bias length + bias velocity
    for name, turned in (("gainprm", [0, 1, 1]), ("biasprm", [1, 0, 0])):
        values = getattr(model, f"actuator_{name}")[:, :3]
        yield from _apart(f"actuator_{name}", names, values[motors], values[images] * signs**turned)
    gear = abs(model.actuator_gear[:, 0])
    yield from _apart("actuator_gear", names, gear[motors], gear[images])
    yield from _of_fields(model, "actuator", names, motors, images, signs)


def _of_fields(
    model: mujoco.MjModel,
    kind: str,
    names: Pairs,
    rows: NDArray,
    images: NDArray,
    signs: Array | float = 1.0,
) -> Iterator[Difference]:
    """Compare all other numbers of geoms, joints, ...: the fields whose names start with `kind`."""
    for field in dir(model):
        values = getattr(model, field, None) if field.startswith(f"{kind}_") else None
        if not isinstance(values, np.ndarray) or SKIPPED.search(field):
            continue
        mirrored = values[images]
        if field.endswith("range"):  # turned around by opposite signs; not all limits have effect
            limited = getattr(model, field.replace("range", "limited")).astype(bool)[:, None]
            values = np.where(limited, values, 0.0)
            mirrored = np.where(signs < 0, -values[images, ::-1], values[images])
        yield from _apart(field, names, values[rows], mirrored)


def _moves_unlike(model: mujoco.MjModel, motion: Motion) -> int | None:
    """Return a joint whose acceleration is not that of its mirror image, in some random state."""
    model = copy.copy(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.solver, model.opt.iterations = mujoco.mjtSolver.mjSOL_NEWTON, 200
    model.opt.tolerance, model.opt.noslip_iterations = 1e-12, 0
    data, random = mujoco.MjData(model), np.random.default_rng(0)

    def accelerations(state: Sequence[Array]) -> Array:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = state
        mujoco.mj_forward(model, data)
        return data.qacc.copy()

    def reflected(reflection: Reflection, values: Array) -> Array:
        return reflection(torch.from_numpy(values)).numpy()

    expected, images = [], []
    for _ in range(POSES):
        qpos, shift = posed(model).qpos, random.uniform(-0.3, 0.3, model.nv)
        mujoco.mj_integratePos(model, qpos, shift, 1.0)
        state = qpos, random.uniform(-1, 1, model.nv), random.uniform(-1, 1, model.nu)
        expected.append(reflected(motion.velocities, accelerations(state)))
        images.append(accelerations([*map(reflected, motion, state)]))
    apart, sizes = (abs(x).max(0) for x in (np.subtract(expected, images), np.array(images)))
    excess = apart - ACCELERATION * sizes
    return int(model.dof_jntid[excess.argmax()]) if excess.max(initial=0.0) > 1e-9 else None


def find_mirror(worlds: Any, tolerance: float = 0.0) -> Mirror:
    """Return the mirror of a robot, which `network.symmetric` needs.

    Args:
        worlds: 2 * PAIRS worlds of an `Environment` in C MuJoCo, all alike, without automatic
            resets.
        tolerance: largest difference between numbers of left and right, see `check`.

    Raises:
        MorlaxError: left and right of the robot or of its objectives differ, it has none, or an
            action is not the control of a motor.
    """
    physics, generator = worlds.physics, torch.Generator().manual_seed(0)
    motion = check(physics.model, tolerance)
    if worlds.action_size != len(motion.motors.order):
        raise _cannot("an action of it is not the control of one motor")

    def draw(*shape: int) -> Tensor:
        return 2 * torch.rand(*shape, generator=generator, dtype=torch.float32) - 1

    shift, speed = SPREAD * draw(2, PAIRS, physics.model.nv).to(physics.qpos)
    for start, change in zip(physics.qpos.numpy(), shift.numpy(), strict=False):
        mujoco.mj_integratePos(physics.model, start, change, 1.0)
    physics.qvel[:PAIRS] = speed
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
    rewards, mirrored = torch.stack(earned[SETTLE:], 1).flatten(1, 2)
    apart, size = (rewards - mirrored).abs(), rewards.abs().mean(0)
    far = apart.mean(0) > ALIKE * size if tolerance else _far(apart, size)
    for name in (name for name, each in zip(worlds.objectives, far, strict=True) if each):
        raise _cannot(f"its mirror image has other rewards of the objective {name}")
    observation = _matching(*torch.stack(seen[SETTLE:], 1).flatten(1, 2), exact=not tolerance)
    if observation.is_none:
        raise _cannot("it has no left and right")
    return Mirror(observation, motion.motors)


def _far(apart: Tensor, size: Tensor) -> Tensor:
    """Return (c,) bool: whether differences (n, c) are more than inexact contacts cause."""
    typical = apart.median(0).values
    return (apart.mean(0) > EXACT * size + TINY) | (typical > USUAL * size + TINY)


def _matching(seen: Tensor, image: Tensor, *, exact: bool) -> Reflection:
    """Return the reflection of features (n, S) that explains what the images saw, (n, S).

    Raises:
        MorlaxError: no reflection does.
    """
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
    if exact:
        far = _far((image - seen[:, order] * sign).abs(), energy[order].sqrt())
    else:
        far = error[rows, order] > ALMOST**2 * (energy + energy[order])
    if far.any():
        raise _cannot(f"number {int(far.int().argmax())} of its observation has no mirror image")
    return Reflection(order, sign)
