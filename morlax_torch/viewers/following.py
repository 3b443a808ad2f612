"""The robot of a model: the part that a camera follows."""

import mujoco
import numpy as np
from numpy.typing import NDArray

HIDDEN_GROUP = 3  # MuJoCo's viewers show geoms of groups 0 to 2 by default
GRAY = np.array([0.5, 0.5, 0.5, 1.0], np.float32)  # the color of a geom that names none
_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def followed_body(model: mujoco.MjModel) -> int:
    """Return the first body that has a joint, or body 1."""
    return int(next(iter(np.flatnonzero(model.body_dofnum)), 1))


def geom_colors(model: mujoco.MjModel) -> NDArray[np.float32]:
    """Return red, green, blue and opacity (ngeom, 4) as MuJoCo draws them.

    A geom's own color is used if it has no material, or if it is not the default gray.
    """
    own, material = model.geom_rgba, model.geom_matid
    if not model.nmat:
        return own
    covered = (material >= 0) & (own == GRAY).all(1)
    return np.where(covered[:, None], model.mat_rgba[material], own)


def shown_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return a mask (ngeom,) of the geoms that viewers show."""
    return (model.geom_group < HIDDEN_GROUP) & (geom_colors(model)[:, 3] > 0)


def robot_geoms(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the shown geoms that move with the followed body's kinematic tree.

    Every geom that moves if that tree has none; every geom that has a size if nothing moves.
    """
    moves = model.body_weldid[model.geom_bodyid] > 0
    sized = (model.geom_rbound > 0) & shown_geoms(model)
    tree = model.body_rootid[min(followed_body(model), model.nbody - 1)]
    ours = model.body_rootid[model.geom_bodyid] == tree
    for mask in (sized & moves & ours, sized & moves, sized):
        if mask.any():
            return np.flatnonzero(mask)
    return np.empty(0, np.intp)


def corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray) -> NDArray[np.float64]:
    """Return the corners (8 G, 3) of the boxes around G geoms, in world coordinates."""
    center, half = np.split(model.geom_aabb[geoms], 2, axis=-1)  # (G, 3) each
    local = center[:, None] + _SIGNS * half[:, None]  # (G, 8, 3)
    turned = local @ data.geom_xmat[geoms].reshape(-1, 3, 3).swapaxes(1, 2)
    return (turned + data.geom_xpos[geoms, None]).reshape(-1, 3)
