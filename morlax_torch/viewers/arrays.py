"""Arrays as the page reads them, among them those that it draws a model from."""

import json

import mujoco
import numpy as np
from numpy.typing import NDArray

from .camera import shown_geoms

# what the page draws; see mjModel
SHAPES = (
    *("geom_type", "geom_bodyid", "geom_group", "geom_matid", "geom_dataid"),
    *("geom_size", "geom_rgba", "geom_pos", "geom_quat", "geom_rbound", "mat_rgba"),
    *("hfield_size", "hfield_nrow", "hfield_ncol", "hfield_adr", "hfield_data"),
)
MESHES = {  # the rows of all meshes, and for each mesh its first row and how many it has
    "mesh_vert": ("mesh_vertadr", "mesh_vertnum"),
    "mesh_normal": ("mesh_normaladr", "mesh_normalnum"),
    "mesh_face": ("mesh_faceadr", "mesh_facenum"),
    "mesh_facenormal": ("mesh_faceadr", "mesh_facenum"),
}


def array_bytes(arrays: dict[str, NDArray], **numbers: float) -> bytes:
    """Return numbers and arrays, as 32-bit floats or integers: a JSON header, then their bytes.

    The page's `arraysOf` reads them.
    """
    known, parts, at = {}, [], 0
    for name, values in arrays.items():
        kind = np.float32 if values.dtype.kind == "f" else np.int32
        data = np.ascontiguousarray(values, kind).tobytes()
        known[name] = [np.dtype(kind).name, at, values.size]
        parts.append(data)
        at += len(data)
    text = json.dumps({**numbers, "arrays": known}).encode()
    text += b" " * (-len(text) % 4)  # arrays begin at a multiple of their size
    return b"".join([np.int32(len(text)).tobytes(), text, *parts])


def drawn_arrays(model: mujoco.MjModel) -> dict[str, NDArray]:
    """Return the arrays that the page draws a model from, without meshes that it does not show."""
    arrays = {name: getattr(model, name) for name in SHAPES}
    meshes = shown_geoms(model) & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    shown = np.isin(np.arange(model.nmesh), model.geom_dataid[meshes])
    for name, (first, number) in MESHES.items():
        counts = getattr(model, number)
        arrays[name] = getattr(model, name)[np.repeat(shown, counts)]
        counts = np.where(shown, counts, 0)
        arrays |= {first: np.cumsum(counts) - counts, number: counts}
    return arrays
