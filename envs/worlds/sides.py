"""Compare the left and right of a model, number by number."""

import copy
import re
from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np
import torch
from mujoco import mjtGeom, mjtJoint
from numpy.typing import ArrayLike, NDArray

from ..errors import MorlaxError
from .mirror import FLIP, Reflection, of_joints

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
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """The reflections of a model's state and control."""

    positions: Reflection  # of qpos
    velocities: Reflection  # of qvel
    motors: Reflection  # of ctrl


class Difference(NamedTuple):
    """A number of one side that is not that of the other side."""

    words: str
    share: float  # of the largest such number of the robot, or of the robot's size


def cannot(reason: str) -> MorlaxError:
    return MorlaxError(
        f"this robot cannot be symmetric, since {reason}: set network.symmetric to false, or "
        "override `mirror` in the task."
    )


def check(
    model: mujoco.MjModel, motion: Motion, tolerance: float = 0.0, *, scene: bool = True
) -> None:
    """Raise MorlaxError if numbers of left and right differ.

    Args:
        model: the robot.
        motion: its reflections.
        tolerance: largest difference to accept, as a share of the largest such number of the robot;
            0 accepts only those from rounding.
        scene: whether to compare geoms that cannot move, too.
    """
    differences = [each for each in _compare(model, motion, scene) if each.share > tolerance]
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
        raise cannot(
            f"{model.joint(joint).name or f'joint {joint}'} and its mirror image accelerate "
            "differently, such as by a tendon or constraint that one side lacks"
        )


def motion_of(model: mujoco.MjModel) -> Motion:
    """Return the reflections of qpos, qvel and ctrl.

    Raises:
        MorlaxError: a joint or motor has no mirrored partner.
    """
    data, joints = _posed(model), _single(model)
    order, sign = of_joints(
        data.xanchor[joints],
        data.xaxis[joints],
        model.jnt_type[joints] == mjtJoint.mjJNT_SLIDE,
        [model.joint(joint).name for joint in joints],
    )
    positions, velocities = Reflection.none(model.nq), Reflection.none(model.nv)
    for joint in np.flatnonzero(model.jnt_type == mjtJoint.mjJNT_FREE):
        start, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        positions.sign[start : start + 7] = torch.tensor([*FLIP, 1.0, *-FLIP])
        velocities.sign[dof : dof + 6] = torch.tensor([*FLIP, *-FLIP])
    for reflection, where in ((positions, model.jnt_qposadr), (velocities, model.jnt_dofadr)):
        rows = torch.from_numpy(where[joints]).long()
        reflection.order[rows] = rows[order]
        reflection.sign[rows] = sign
    return Motion(positions, velocities, _of_motors(model, velocities))


def _of_motors(model: mujoco.MjModel, velocities: Reflection) -> Reflection:
    """Return the reflection of ctrl, from that of qvel."""
    kinds = model.actuator_trntype
    if len(kinds) != model.nu or (kinds != mujoco.mjtTrn.mjTRN_JOINT).any():
        raise cannot("it has actuators that do not move one joint")
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]].tolist()
    motors = [(dof, dofs[:i].count(dof)) for i, dof in enumerate(dofs)]  # several may move a joint
    order = velocities.order.tolist()
    images = [(order[dof], number) for dof, number in motors]
    if not set(images) <= set(motors):
        raise cannot("a joint without a motor mirrors one with a motor")
    partners, gear = [motors.index(image) for image in images], np.sign(model.actuator_gear[:, 0])
    return Reflection.of(partners, velocities.sign[dofs].numpy() * gear * gear[partners])


def _posed(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the pose in which left and right are compared; free bodies stand in a row."""
    data = mujoco.MjData(model)
    for k, joint in enumerate(np.flatnonzero(model.jnt_type == mjtJoint.mjJNT_FREE)):
        start = model.jnt_qposadr[joint]
        data.qpos[start : start + 7] = 100.0 * k, 0, 0, 1, 0, 0, 0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def _single(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the joints with one degree of freedom."""
    return np.flatnonzero(model.jnt_type >= int(mjtJoint.mjJNT_SLIDE))


def _compare(model: mujoco.MjModel, motion: Motion, scene: bool) -> Iterator[Difference]:
    """Compare the numbers of bodies, geoms, joints and motors with those of their partners."""
    data, order = _posed(model), motion.velocities.order
    partner = model.dof_jntid[order[model.jnt_dofadr]] if model.njnt else np.empty(0, int)
    links = {0: 0}  # of bodies that move together, their partners; 0 are those that cannot move
    for ours, its in model.body_weldid[model.jnt_bodyid[np.array([range(model.njnt), partner]).T]]:
        if links.setdefault(int(ours), int(its)) != its:
            raise cannot(f"{model.body(ours).name} mirrors two bodies")
    moving = [link for link in links if link]
    centers = data.subtree_com[moving] - data.subtree_com[model.body_rootid[moving]]
    size = float(np.linalg.norm(centers, axis=1).max(initial=0.0)) or 1.0  # of the robot, in m
    yield from _of_masses(model, data, {link: links[link] for link in moving}, size)
    yield from _of_geoms(model, data, links if scene else {x: links[x] for x in moving}, size)
    yield from _of_joints(model, data, motion, partner, size)
    yield from _of_actuators(model, motion)
    for name in ("gravity", "wind"):
        if abs(sideways := getattr(model.opt, name)[1]) > ROUNDING:
            yield Difference(f"{name} points to one side: {sideways:g}", np.inf)


def _apart(
    field: str,
    names: Sequence[Sequence[str]],
    values: ArrayLike,
    images: ArrayLike,
    floor: ArrayLike | None = None,
    largest: float | None = None,
) -> Iterator[Difference]:
    """Compare values (n, c) with those of mirror images (n, c).

    Args:
        field: name of the values.
        names: of n things, and of their n partners.
        values, images: see above.
        floor: (n, 1) or a number, to whose size rounding is relative, if values are smaller.
        largest: number that differences are shares of.
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


def _of_masses(
    model: mujoco.MjModel, data: mujoco.MjData, links: dict[int, int], size: float
) -> Iterator[Difference]:
    """Compare mass, center of mass and inertia of links: of bodies that move together."""
    turns = data.ximat.reshape(-1, 3, 3)
    inertias = turns * model.body_inertia[:, None] @ turns.swapaxes(1, 2)

    def of_link(link: int) -> tuple[float, Array, Array]:
        bodies = np.flatnonzero(model.body_weldid == link)
        mass, places = model.body_mass[bodies], data.xipos[bodies]
        center = mass @ places / max(mass.sum(), 1e-300)  # 0 without mass
        arms = places - center
        squares = (arms**2).sum(1)[:, None, None] * np.eye(3) - arms[:, :, None] * arms[:, None]
        return mass.sum(), center, (inertias[bodies] + mass[:, None, None] * squares).sum(0)

    pairs = [(link, other) for link, other in links.items() if link <= other]
    names = [[model.body(pair[k]).name or f"body {pair[k]}" for pair in pairs] for k in (0, 1)]
    if not pairs:
        return
    ours, its = (
        [np.array(x) for x in zip(*map(of_link, k), strict=True)] for k in zip(*pairs, strict=True)
    )
    norms = abs(ours[2]).max((1, 2))[:, None]
    yield from _apart("mass", names, ours[0], its[0])
    yield from _apart("center of mass", names, ours[1], its[1] * FLIP, size, size)
    images = its[2] * np.outer(FLIP, FLIP)
    yield from _apart("inertia", names, ours[2], images, norms, norms.max())


def _of_geoms(
    model: mujoco.MjModel, data: mujoco.MjData, links: dict[int, int], size: float
) -> Iterator[Difference]:
    """Compare geoms that can touch others."""
    touching = (model.geom_contype | model.geom_conaffinity) > 0
    touching[[*model.pair_geom1, *model.pair_geom2]] = True
    touching &= ~np.isin(model.geom_type, UNKNOWN)
    shapes = {i: _shape(model, data, i) for i in np.flatnonzero(touching).tolist()}
    pairs = []
    for link, other in links.items():
        if link > other:
            continue
        bodies = (np.flatnonzero(model.body_weldid == each) for each in (link, other))
        ours, free = ([i for i in shapes if model.geom_bodyid[i] in each] for each in bodies)
        for geom in ours:
            center, points = shapes[geom]
            distances = [
                float(np.linalg.norm(center - shapes[i][0] * FLIP))
                + _gap(points, shapes[i][1] * FLIP)
                if model.geom_type[i] == model.geom_type[geom]
                else np.inf
                for i in free
            ]
            if min(distances, default=np.inf) < np.inf:
                pairs.append((geom, free.pop(int(np.argmin(distances)))))
            else:
                yield Difference(f"{_geom(model, geom)} has no mirrored partner", np.inf)
        if link != other:
            for geom in free:
                yield Difference(f"{_geom(model, geom)} has no mirrored partner", np.inf)
    pairs = [(i, k) for i, k in pairs if i <= k or (k, i) not in pairs]
    first, order = np.array(pairs, int).reshape(-1, 2).T
    names = [[_geom(model, i) for i in each] for each in (first, order)]
    places, images = [shapes[i][0] for i in first], [shapes[i][0] * FLIP for i in order]
    yield from _apart("position", names, places, images, size, size)
    gaps = [_gap(shapes[i][1], shapes[k][1] * FLIP) for i, k in pairs]
    yield from _apart("size or direction", names, gaps, np.zeros(len(gaps)), size, size)
    radius = np.where(np.isin(model.geom_type, ROUND), model.geom_size[:, 0], 0.0)
    for field, values in (("radius", radius), *_fields(model, "geom")):
        yield from _apart(field, names, values[first], values[order])


def _geom(model: mujoco.MjModel, geom: int) -> str:
    body = model.body(model.geom_bodyid[geom]).name
    return model.geom(geom).name or f"geom {geom} of {body or 'a body'}"


def _shape(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[Array, Array]:
    """Return a geom's center (3,), and points (P, 3) around it that show size and direction."""
    center, turn = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    size = model.geom_size[geom]
    match int(model.geom_type[geom]):
        case mjtGeom.mjGEOM_PLANE:
            normal = turn[:, 2]
            return normal * (normal @ center), normal[None]
        case mjtGeom.mjGEOM_CAPSULE | mjtGeom.mjGEOM_CYLINDER:
            return center, np.outer((-size[1], size[1]), turn[:, 2])
        case mjtGeom.mjGEOM_ELLIPSOID:
            return center, np.concatenate([np.diag(size), -np.diag(size)]) @ turn.T
        case mjtGeom.mjGEOM_BOX:
            return center, CORNERS * size @ turn.T
        case mjtGeom.mjGEOM_MESH:  # whose left and right may have other vertices: its extent
            mesh = model.geom_dataid[geom]
            start, number = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            points = model.mesh_vert[start : start + number] @ turn.T
            low, high = points.min(0), points.max(0)
            return center + (low + high) / 2, CORNERS * (high - low) / 2
    return center, np.zeros((1, 3))


def _gap(points: Array, others: Array) -> float:
    """Return the largest distance from one of the points (P, 3) to the nearest of others."""
    return float(np.linalg.norm(points[:, None] - others, axis=-1).min(1).max())


def _of_joints(
    model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, partner: NDArray, size: float
) -> Iterator[Difference]:
    joints = np.array([joint for joint in _single(model) if joint <= partner[joint]], int)
    others = partner[joints]
    names = [[model.joint(j).name or f"joint {j}" for j in each] for each in (joints, others)]
    dofs, its = model.jnt_dofadr[joints], model.jnt_dofadr[others]
    signs = motion.velocities.sign.double().numpy()[dofs, None]
    slides, axes = (model.jnt_type[joints] == mjtJoint.mjJNT_SLIDE)[:, None], data.xaxis[joints]
    image = np.where(slides, FLIP, -FLIP) * data.xaxis[others] * signs
    yield from _apart("axis", names, axes, image, 1.0, 1.0)
    shift = np.where(slides, 0.0, data.xanchor[joints] - data.xanchor[others] * FLIP)
    shift -= (shift * axes).sum(1, keepdims=True) * axes  # along the axis, it has no effect
    yield from _apart("position", names, shift, np.zeros_like(shift), size, size)
    for field, values in _fields(model, "jnt"):
        image = _mirrored(field, values[others], signs)
        yield from _apart(field, names, values[joints], image)
    for field in ("qpos0", "qpos_spring"):
        values = getattr(model, field)[model.jnt_qposadr]
        yield from _apart(field, names, values[joints], values[others] * signs[:, 0])
    for field, values in _fields(model, "dof"):
        yield from _apart(field, names, values[dofs], values[its])


def _of_actuators(model: mujoco.MjModel, motion: Motion) -> Iterator[Difference]:
    others, signs = motion.motors.order.numpy(), motion.motors.sign.double().numpy()[:, None]
    first = np.flatnonzero(np.arange(model.nu) <= others)
    others, signs = others[first], signs[first]
    names = [[model.actuator(i).name or f"motor {i}" for i in each] for each in (first, others)]
    # force = (gain + gain length + gain velocity) ctrl + bias + bias length + bias velocity
    same, turned = np.ones_like(signs), signs
    gains = ("gainprm", (same, turned, turned)), ("biasprm", (turned, same, same))
    for name, factors in gains:
        values = getattr(model, f"actuator_{name}")[:, :3]
        image = values[others] * np.concatenate(factors, 1)
        yield from _apart(f"actuator_{name}", names, values[first], image)
    gear = abs(model.actuator_gear[:, 0])
    for field, values in (("actuator_gear", gear), *_fields(model, "actuator")):
        image = _mirrored(field, values[others], signs)
        yield from _apart(field, names, values[first], image)


def _fields(model: mujoco.MjModel, kind: str) -> Iterator[tuple[str, Array]]:
    """Yield the numbers of all geoms, joints, ... by field; 0 for limits without effect."""
    for name in dir(model):
        values = getattr(model, name, None) if name.startswith(f"{kind}_") else None
        if not isinstance(values, np.ndarray) or SKIPPED.search(name):
            continue
        limited = getattr(model, name.replace("range", "limited"), None)
        if name.endswith("range") and limited is not None:
            values = np.where(limited.astype(bool)[:, None], values, 0.0)
        yield name, values


def _mirrored(field: str, values: Array, signs: Array) -> Array:
    """Return values (n, c) of partners whose signs are (n, 1): ranges may be turned around."""
    return np.where(signs < 0, -values[:, ::-1], values) if field.endswith("range") else values


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

    ours, images = [], []
    for _ in range(POSES):
        qpos, shift = _posed(model).qpos, random.uniform(-0.3, 0.3, model.nv)
        mujoco.mj_integratePos(model, qpos, shift, 1.0)
        state = qpos, random.uniform(-1, 1, model.nv), random.uniform(-1, 1, model.nu)
        mirrored = [
            each(torch.from_numpy(x)).numpy() for each, x in zip(motion, state, strict=True)
        ]
        ours.append(motion.velocities(torch.from_numpy(accelerations(state))).numpy())
        images.append(accelerations(mirrored))
    apart, sizes = (abs(x).max(0) for x in (np.subtract(ours, images), np.array(images)))
    excess = apart - ACCELERATION * sizes
    return int(model.dof_jntid[excess.argmax()]) if excess.max(initial=0.0) > 1e-9 else None
