"""A MuJoCo model in viser: its geoms as meshes, above a moving ground."""

import itertools

import mujoco
import numpy as np
import trimesh
import viser

from ..following import followed_body

HIDDEN_GROUP = 3  # MuJoCo's viewers show geoms of groups 0 to 2 by default
SQUARE = 1.0  # m between the ground's major grid lines
_numbers = itertools.count()  # unique names: viser gives a reused name the old pose


class RobotScene:
    """One robot, kept at the origin while the ground moves.

    The cameras of the browsers stay in place, so each user keeps their own orbit and zoom.
    """

    def __init__(self, server: viser.ViserServer, model: mujoco.MjModel):
        shown = [geom for geom in range(model.ngeom) if model.geom_group[geom] < HIDDEN_GROUP]
        meshes = {geom: geom_mesh(model, geom) for geom in shown}  # may fail: nothing is added yet
        self._server, self._followed = server, followed_body(model)
        root = f"/robot{next(_numbers)}"
        self._root = server.scene.add_frame(root, show_axes=False)
        self._bodies = {}
        for geom, mesh in meshes.items():
            if mesh is None:
                continue
            body = int(model.geom_bodyid[geom])
            if body not in self._bodies:
                self._bodies[body] = server.scene.add_frame(f"{root}/{body}", show_axes=False)
            red, green, blue, opacity = geom_color(model, geom)
            server.scene.add_mesh_simple(
                f"{root}/{body}/{geom}",
                mesh.vertices,
                mesh.faces,
                color=(red, green, blue),
                opacity=opacity if opacity < 1 else None,
                flat_shading=model.geom_type[geom] in FLAT,
                position=model.geom_pos[geom],
                wxyz=model.geom_quat[geom],
            )
        self._ground = server.scene.add_grid(
            f"{root}/ground",
            infinite_grid=True,
            cell_size=SQUARE / 2,
            section_size=SQUARE,
            cell_color=(214, 219, 226),
            section_color=(170, 178, 190),
            plane_color=(236, 239, 243),
            plane_opacity=1.0,
            shadow_opacity=0.3,
            fade_distance=30.0,
        )

    def draw(self, data: mujoco.MjData) -> None:
        """Move every body to its pose in `data`; a state that is not finite is skipped."""
        if not np.isfinite(data.xpos).all():
            return
        center = np.array([*data.xpos[self._followed, :2], 0.0])
        with self._server.atomic():
            self._ground.position = -np.fmod(center, SQUARE)
            for body, frame in self._bodies.items():
                frame.position = data.xpos[body] - center
                frame.wxyz = data.xquat[body]

    def remove(self) -> None:
        """Remove the robot and the ground from the scene."""
        self._root.remove()


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


def geom_color(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Return red, green, blue and opacity in [0, 1], from the geom's material if it has one."""
    material = model.geom_matid[geom]
    return model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
