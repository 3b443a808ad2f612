"""Rendered images have the right size and keep the robot in view."""

import subprocess
import sys

import mujoco
import numpy as np
import pytest

from morlax_torch import MorlaxError
from morlax_torch.viewers.filming.rendering import Scene
from morlax_torch.viewers.player import Player

ROBOTS = ("ant", "cheetah", "hopper", "humanoid", "walker")
BALL = """
<mujoco>
  <worldbody>
    <light pos="0 0 9" dir="0 0 -1" type="directional"/>
    <geom type="plane" size="0 0 1" rgba="0 0 1 1"/>
    <body pos="0 0 1"><freejoint/><geom size="0.4" rgba="1 0 0 1"/></body>
  </worldbody>
</mujoco>
"""


def robot_in(model: mujoco.MjModel, data: mujoco.MjData, width: int, height: int) -> np.ndarray:
    """Return a mask (height, width) of the robot from MuJoCo's segmentation rendering."""
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, "track")
        thing, kind = np.moveaxis(renderer.render(), -1, 0)
    return (kind == mujoco.mjtObj.mjOBJ_GEOM) & (model.geom_bodyid[thing] > 0)


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("task", ROBOTS)
def test_the_camera_follows_the_robot(task, make_policy):
    player = Player(make_policy(task), (0.5, 0.5))
    with Scene(player.model, 120, 90) as scene:
        at_home = scene.draw(player.data)
        player.env.physics.qpos[0, 0] += 40.0
        player.place()
        far_away = scene.draw(player.data)
    robot = robot_in(player.model, player.data, 120, 90)
    assert 0.01 < robot.mean() < 0.5
    y, x = np.argwhere(robot).mean(0)
    assert 40 < x < 80 and 25 < y < 65
    difference = np.abs(at_home.astype(int) - far_away)
    assert np.median(difference[robot]) <= 2  # light and camera follow the robot


@pytest.mark.usefixtures("opengl")
def test_a_custom_robot_needs_no_camera():
    model = mujoco.MjModel.from_xml_string(BALL)
    data = mujoco.MjData(model)
    data.qpos[0] = 50.0
    mujoco.mj_forward(model, data)
    with Scene(model, 80, 80) as scene:
        picture = scene.draw(data).astype(int)
    red = picture[..., 0] > picture[..., 2] + 50
    assert red.any()
    np.testing.assert_allclose(np.argwhere(red).mean(0), 40, atol=8)


@pytest.mark.usefixtures("opengl")
def test_an_image_can_exceed_the_model_s_offscreen_size():
    model = mujoco.MjModel.from_xml_string(BALL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with Scene(model, 1000, 700) as scene:
        picture = scene.draw(data)
    assert picture.shape == (700, 1000, 3) and picture.dtype == np.uint8


@pytest.mark.parametrize("size", [(0, 360), (480, -1), (5000, 360)])
def test_an_invalid_image_size_gives_a_clear_error(size):
    with pytest.raises(MorlaxError, match="from 64 to 4096 pixels"):
        Scene(mujoco.MjModel.from_xml_string(BALL), *size)


def test_without_opengl_the_error_says_what_to_install():
    program = (
        "import os, mujoco\n"
        "from morlax_torch import MorlaxError\n"
        "from morlax_torch.viewers.filming.rendering import Scene\n"
        "os.environ['MUJOCO_GL'] = 'none'\n"
        "try: Scene(mujoco.MjModel.from_xml_string('<mujoco/>'))\n"
        "except MorlaxError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert not done.stderr
    assert "tried: none" in done.stdout
    assert "libegl1" in done.stdout and "MUJOCO_GL" in done.stdout
