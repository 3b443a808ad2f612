"""Robots side by side, with names above them."""

from collections.abc import Sequence

import viser

from . import camera
from .behavior import Behavior
from .ground import Ground
from .overlays import Overlays, Shown
from .scene import RobotScene

FOG = {False: (255, 255, 255), True: (20, 20, 20)}  # viser's background, by whether it is dark
GAP = 1.15  # between the middles of neighbors, times the robot's size
ABOVE = 0.95  # height of a name, times the robot's size


class Stage:
    """Everything that a page shows of its robots outside the panels.

    `behaviors` are the robots on it, from left to right.

    Args:
        server: viser's server.
        shown: the arrows and trails to draw.
    """

    def __init__(self, server: viser.ViserServer, shown: Shown):
        self._server, self._shown = server, shown
        self._dark = False
        self._overlays: list[Overlays] = []
        self.behaviors: tuple[Behavior, ...] = ()
        self._scenes: list[RobotScene] = []
        self._labels: list[viser.LabelHandle] = []
        self._ground: Ground | None = None
        server.scene.world_axes.visible = False
        server.initial_camera.fov = camera.FIELD

    def show(self, behaviors: Sequence[Behavior], names: Sequence[str]) -> None:
        """Show other robots, from left to right; those before stay if this fails.

        Args:
            behaviors: at least one.
            names: of each, or of none.
        """
        size = max(float(behavior.model.stat.extent) for behavior in behaviors)
        gap = GAP * size
        places = [gap * (i - (len(behaviors) - 1) / 2) for i in range(len(behaviors))]
        scenes: list[RobotScene] = []
        try:
            for behavior, x in zip(behaviors, places, strict=True):
                scenes.append(RobotScene(self._server, behavior.model, x))
        except BaseException:
            for scene in scenes:
                scene.remove()
            raise
        same_robot = bool(self.behaviors) and self.behaviors[0].model is behaviors[0].model
        self.remove()
        self.behaviors, self._scenes = tuple(behaviors), scenes
        self._size, self._places, self._width = size, places, gap * (len(behaviors) - 1) + size
        self._add_ground()
        self._overlays = [
            Overlays(self._server, scene, behavior.model, self._shown)
            for scene, behavior in zip(scenes, behaviors, strict=True)
        ]
        self._labels = [
            self._server.scene.add_label(
                f"{scene.root}/name",
                name,
                position=(0.0, 0.0, ABOVE * scene.size),
                anchor="bottom-center",
                font_screen_scale=1.2,
            )
            for scene, name in zip(scenes, names, strict=False)
        ]
        camera.set_initial(self._server, size)
        for client in self._server.get_clients().values():
            camera.fit(client, size, self._width, keep_direction=same_robot)

    def rename(self, names: Sequence[str]) -> None:
        """Change the names above the robots."""
        for label, name in zip(self._labels, names, strict=True):
            if label.text != name:
                label.text = name

    def darken(self, dark: bool) -> None:
        """Show the scene in colors for a dark page, or for a light one."""
        if dark != self._dark:
            self._dark = dark
            self._add_ground()

    def welcome(self, client: viser.ClientHandle) -> None:
        """Fit the camera of a new browser, and again once its panels have taken their place."""

        def fit() -> None:
            camera.fit(client, self._size, self._width, keep_direction=False)

        fit()
        camera.on_first_resize(client, fit)

    def draw(self) -> None:
        """Move the robots to their current states."""
        with self._server.atomic():
            centers = []
            parts = zip(self._scenes, self._overlays, self.behaviors, strict=True)
            for scene, overlays, behavior in parts:
                center = scene.draw(behavior.data)
                if center is not None:
                    overlays.draw(behavior.data, center, behavior.commanded())
                    centers.append(center)
            if self._ground is not None and len(centers) == len(self._scenes):
                self._ground.move(centers)

    def remove(self) -> None:
        """Remove the robots and the ground."""
        for scene in self._scenes:
            scene.remove()
        if self._ground is not None:
            self._ground.remove()
        self._scenes, self._labels, self._ground = [], [], None

    def _add_ground(self) -> None:
        if self._ground is not None:
            self._ground.remove()
        gap = GAP * self._size
        self._ground = Ground(self._server, self._places, gap, self._dark)
        self._server.scene.configure_fog(10.0, 30.0, color=FOG[self._dark])
