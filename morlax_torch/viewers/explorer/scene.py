"""A MuJoCo model in viser: its geoms as meshes, kept in place while the world moves."""

import itertools

import mujoco
import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from ..camera import followed_body, geom_colors, shown_geoms

JUMP = 0.45  # times the robot's size; a robot that goes further up or down is followed
_numbers = itertools.count()  # unique names: viser gives a reused name the old pose


class RobotScene:
    """One robot, kept at a place while its world moves.

    The cameras of the browsers stay in place, so each user keeps their own orbit and zoom.

    Args:
        server: viser's server.
        model: the robot.
        x: the robot's place along x, in m.
    """

    def __init__(self, server: viser.ViserServer, model: mujoco.MjModel, x: float = 0.0):
        shown = np.flatnonzero(shown_geoms(model)).tolist()
        meshes = {geom: geom_mesh(model, geom) for geom in shown}  # may fail: nothing is added yet
        self.followed, self.size = followed_body(model), float(model.stat.extent)
        self.root = f"/robot{next(_numbers)}"
        self._frame = server.scene.add_frame(self.root, show_axes=False, position=(x, 0.0, 0.0))
        self._height: float | None = None  # m; of the followed body when it was first drawn
        self._bodies, colors = {}, geom_colors(model)
        for geom, mesh in meshes.items():
            if mesh is None:
                continue
            body = int(model.geom_bodyid[geom])
            if body not in self._bodies:
                name = f"{self.root}/{body}"
                self._bodies[body] = server.scene.add_frame(name, show_axes=False)
            red, green, blue, opacity = colors[geom]
            server.scene.add_mesh_simple(
                f"{self.root}/{body}/{geom}",
                mesh.vertices,
                mesh.faces,
                color=(red, green, blue),
                opacity=opacity if opacity < 1 else None,
                flat_shading=model.geom_type[geom] in FLAT,
                position=model.geom_pos[geom],
                wxyz=model.geom_quat[geom],
            )

    def draw(self, data: mujoco.MjData) -> NDArray[np.float64] | None:
        """Move every body to its pose in `data`.

        Returns:
            The point (3,) of the world that lies at the robot's place; None if the state is not
            finite and was skipped.
        """
        if not np.isfinite(data.xpos).all():
            return None
        x, y, z = data.xpos[self.followed]
        if self._height is None:
            self._height = float(z)
        rise, most = float(z) - self._height, JUMP * self.size
        center = np.array([x, y, rise - np.clip(rise, -most, most)])
        for body, frame in self._bodies.items():
            frame.position = data.xpos[body] - center
            frame.wxyz = data.xquat[body]
        return center

    def remove(self) -> None:
        """Remove the robot from the scene."""
        self._frame.remove()


FLAT = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_MESH)


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Return a geom's surface in its own frame, in meters; None for planes and height fields."""
    size = model.geom_size[geom]
    kind, create = model.geom_type[geom], trimesh.creation
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return create.icosphere(subdivisions=3, radius=size[0])
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return create.icosphere(subdivisions=3).apply_scale(size)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return create.capsule(height=2 * size[1], radius=size[0], count=[24, 16])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return create.cylinder(radius=size[0], height=2 * size[1])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return create.box(extents=2 * size)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        vertices, faces = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        return trimesh.Trimesh(
            model.mesh_vert[vertices : vertices + model.mesh_vertnum[mesh]],
            model.mesh_face[faces : faces + model.mesh_facenum[mesh]],
        )
    return None
