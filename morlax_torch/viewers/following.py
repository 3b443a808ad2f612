"""The robot of a model: the part that a camera follows."""

import mujoco
import numpy as np
from numpy.typing import NDArray

HIDDEN_GROUP = 3  # MuJoCo's viewers show geoms of groups 0 to 2 by default
_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def followed_body(model: mujoco.MjModel) -> int:
    """Return the first body that has a joint, or body 1."""
    return int(next(iter(np.flatnonzero(model.body_dofnum)), 1))


def shown_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return a mask (ngeom,) of the geoms that viewers show."""
    material = model.geom_matid
    opacity = np.where(material >= 0, 1.0, model.geom_rgba[:, 3])
    if model.nmat:
        opacity = np.where(material >= 0, model.mat_rgba[material, 3], opacity)
    return (model.geom_group < HIDDEN_GROUP) & (opacity > 0)


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
