"""Arrows and a trail drawn at a robot, from the state of its MuJoCo model."""

from collections import deque
from dataclasses import dataclass

import mujoco
import numpy as np
import viser
from numpy.typing import NDArray

from .scene import JUMP, RobotScene

VELOCITY, COMMAND, CONTACTS, TRAIL = "velocity", "command arrow", "contact forces", "trail"
KINDS = (VELOCITY, COMMAND, CONTACTS, TRAIL)
COLORS = {
    VELOCITY: (0, 114, 178),
    COMMAND: (0, 158, 115),
    CONTACTS: (213, 94, 0),
    TRAIL: (134, 142, 150),
}
STRIDE = 0.25  # s that arrows of velocities look ahead
WEIGHT = 0.5  # length of an arrow that carries the robot's weight, times the robot's size
POINTS = 80  # of a trail, one per frame


@dataclass
class Shown:
    """What users want to see; shared by all robots."""

    kinds: frozenset[str] = frozenset({COMMAND})


class Overlays:
    """The arrows and the trail of one robot.

    Args:
        server: viser's server.
        scene: of the robot.
        model: of the robot.
        shown: what to draw.
    """

    def __init__(
        self, server: viser.ViserServer, scene: RobotScene, model: mujoco.MjModel, shown: Shown
    ):
        self._server, self._scene, self._model, self._shown = server, scene, model, shown
        self._nodes: dict[str, viser.ArrowsHandle | viser.LineSegmentsHandle] = {}
        self._trail: deque[NDArray[np.float64]] = deque(maxlen=POINTS)
        self._newtons = float(model.body_subtreemass[0] * np.linalg.norm(model.opt.gravity))

    def draw(
        self, data: mujoco.MjData, center: NDArray[np.float64], command: NDArray[np.float64] | None
    ) -> None:
        """Draw what is shown.

        Args:
            data: the robot's state, with contacts after `mj_forward`.
            center: the point (3,) of the world that lies at the robot's place.
            command: (2,) commanded velocity in m/s, forward and left; None without one.
        """
        body = self._scene.followed
        middle = data.xipos[body]
        if self._trail and np.linalg.norm(middle - self._trail[-1]) > JUMP * self._scene.size:
            self._trail.clear()  # a new episode
        self._trail.append(middle.copy())
        up = np.array([0.0, 0.0, self._scene.size])
        drawn: dict[str, NDArray[np.float64]] = {}
        if VELOCITY in self._shown.kinds:
            ahead = STRIDE * velocity(self._model, data, body)
            drawn[VELOCITY] = np.array([[middle + 0.3 * up, middle + 0.3 * up + ahead]])
        if COMMAND in self._shown.kinds and command is not None:
            start = middle + 0.36 * up
            drawn[COMMAND] = np.array([[start, start + heading(data, body) @ command]])
        if CONTACTS in self._shown.kinds:
            scale = WEIGHT * self._scene.size / max(self._newtons, 1e-9)
            drawn[CONTACTS] = shortened(contact_forces(self._model, data, scale), self._scene.size)
        if TRAIL in self._shown.kinds and len(self._trail) > 1:
            points = np.array(self._trail)
            drawn[TRAIL] = np.stack([points[:-1], points[1:]], 1)
        for kind in KINDS:
            segments = drawn.get(kind, np.zeros((0, 2, 3)))
            self._put(kind, (segments - center).astype(np.float32))

    def _put(self, kind: str, segments: NDArray[np.float32]) -> None:
        """Show the segments (n, 2, 3) of a kind; arrows shorter than their width are left out."""
        width = 0.012 * self._scene.size
        if kind != TRAIL:
            segments = segments[np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1) > 3 * width]
        node = self._nodes.get(kind)
        if not len(segments):
            if node is not None:
                node.visible = False
        elif node is not None:
            node.points, node.visible = segments, True
        elif kind == TRAIL:
            name = f"{self._scene.root}/{kind}"
            self._nodes[kind] = self._server.scene.add_line_segments(
                name, segments, colors=COLORS[kind], thickness=2.5, thickness_units="screen"
            )
        else:
            self._nodes[kind] = self._server.scene.add_arrows(
                f"{self._scene.root}/{kind.replace(' ', '-')}",
                segments,
                colors=COLORS[kind],
                shaft_radius=width,
                head_radius=2.2 * width,
                head_length=4 * width,
            )


def velocity(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> NDArray[np.float64]:
    """Return the velocity (3,) of a body's center of mass in m/s, in the world's frame."""
    found = np.zeros(6)  # angular, then linear
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, found, 0)
    return found[3:]


def heading(data: mujoco.MjData, body: int) -> NDArray[np.float64]:
    """Return the horizontal directions (3, 2) forward and to the left of a body, as columns."""
    forward = data.xmat[body].reshape(3, 3)[:2, 0]
    length = np.linalg.norm(forward)
    x, y = forward / length if length > 1e-6 else (1.0, 0.0)
    return np.array([[x, -y], [y, x], [0.0, 0.0]])


def shortened(arrows: NDArray[np.float64], most: float) -> NDArray[np.float64]:
    """Return arrows (n, 2, 3) no longer than `most` m, because impacts are many times a weight."""
    reach = arrows[:, 1] - arrows[:, 0]
    length = np.linalg.norm(reach, axis=1, keepdims=True)
    reach = reach * np.minimum(1.0, most / np.maximum(length, 1e-12))
    return np.stack([arrows[:, 0], arrows[:, 0] + reach], 1)


def contact_forces(model: mujoco.MjModel, data: mujoco.MjData, scale: float) -> NDArray[np.float64]:
    """Return arrows (n, 2, 3) of the forces at each contact, `scale` m per newton, upwards."""
    arrows = np.zeros((data.ncon, 2, 3))
    for i in range(data.ncon):
        force = np.zeros(6)
        mujoco.mj_contactForce(model, data, i, force)
        contact = data.contact[i]
        world = contact.frame.reshape(3, 3).T @ force[:3]
        world = world if world[2] >= 0 else -world  # as the ground pushes the robot
        arrows[i] = contact.pos, contact.pos + scale * world
    return arrows
