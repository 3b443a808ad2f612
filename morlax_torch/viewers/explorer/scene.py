"""A MuJoCo model in viser: its geoms as meshes, over a ground that passes below."""

import itertools

import mujoco
import numpy as np
import trimesh
import viser

HIDDEN_GROUP = 3  # MuJoCo's own viewers show geoms of groups 0 to 2
SQUARE = 1.0  # m between the strong lines of the ground
_numbers = itertools.count()  # viser gives a new node of an old name the old one's pose


class RobotScene:
    """One robot, kept at the origin: the ground moves instead of every browser's camera.

    So each user's orbit and zoom stay as they are.
    """

    def __init__(self, server: viser.ViserServer, model: mujoco.MjModel):
        self._server = server
        root = f"/robot{next(_numbers)}"
        self._root = server.scene.add_frame(root, show_axes=False)
        self._bodies = {}
        for geom in range(model.ngeom):
            if model.geom_group[geom] >= HIDDEN_GROUP:
                continue
            mesh = geom_mesh(model, geom)
            if mesh is None:
                continue
            body = int(model.geom_bodyid[geom])
            if body not in self._bodies:
                self._bodies[body] = server.scene.add_frame(f"{root}/{body}", show_axes=False)
            red, green, blue, opacity = geom_colour(model, geom)
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
        """Put every body where `data` has it; a state that is not finite is not drawn."""
        if not np.isfinite(data.xpos).all():
            return
        centre = np.array([*data.xpos[1, :2], 0.0])
        with self._server.atomic():
            self._ground.position = -np.fmod(centre, SQUARE)
            for body, frame in self._bodies.items():
                frame.position = data.xpos[body] - centre
                frame.wxyz = data.xquat[body]

    def remove(self) -> None:
        """Take everything out of the scene."""
        self._root.remove()


FLAT = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_MESH)


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """The surface of a geom in its own frame, in metres; None where it is a plane or a field."""
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


def geom_colour(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """(4,) red, green, blue and opacity in [0, 1], from the geom's material if it has one."""
    material = model.geom_matid[geom]
    return model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
