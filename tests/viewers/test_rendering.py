"""Rendered images have the right size, and the robot stays large and in view."""

import mujoco
import numpy as np
import pytest

from morlax_torch import MorlaxError, load
from morlax_torch.adapters.gymnasium import Pictures
from morlax_torch.viewers.camera import FollowingCamera, cameras_for
from morlax_torch.viewers.filming.recording import Take
from morlax_torch.viewers.filming.rendering import Scene, choose_opengl
from morlax_torch.viewers.player import Player

ROBOTS = ("ant", "bruce", "cheetah", "cheetah3", "hopper", "humanoid", "walker")
BALL = """
<mujoco>
  <worldbody>
    <light pos="0 0 9" dir="0 0 -1" type="directional"/>
    <geom type="plane" size="0 0 1" rgba="0 0 1 1"/>
    <body pos="0 0 1"><freejoint/><geom size="0.4" rgba="1 0 0 1"/></body>
  </worldbody>
</mujoco>
"""


def shares(renderer: mujoco.Renderer, data: mujoco.MjData, camera: mujoco.MjvCamera) -> np.ndarray:
    """Return left, bottom, right and top of the robot in a 4:3 picture, as drawn, in [0, 1]."""
    renderer.update_scene(data, camera)
    thing, kind = np.moveaxis(renderer.render(), -1, 0)
    moving = renderer.model.geom_bodyid[thing] > 0
    robot = np.argwhere((kind == mujoco.mjtObj.mjOBJ_GEOM) & moving)
    (top, left), (bottom, right) = robot.min(0), robot.max(0) + 1
    return np.array([left / 120, 1 - bottom / 90, right / 120, 1 - top / 90])


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("task", ROBOTS)
def test_the_robot_is_large_and_stays_in_the_picture_for_an_episode(task):
    policy = load(task)
    player = Player(policy, [1.0] * len(policy.objectives))
    following, seen = FollowingCamera(player.model, 4 / 3), []
    following.restart(player.data)
    steps = round(2.0 / player.env.dt)
    with mujoco.Renderer(player.model, 90, 120) as renderer:
        renderer.enable_segmentation_rendering()
        for step in range(steps):
            if step % (steps // 8) == 0:
                seen.append(shares(renderer, player.data, following.camera))
            if player.step().terminated:
                break
            following.follow(player.data, player.env.dt)
    sides = np.stack(seen)
    assert sides.min() > 0 and sides.max() < 1
    sizes = (sides[:, 2:] - sides[:, :2]).max(1)
    assert 0.5 < sizes[0] < 0.85
    assert sizes.min() > 0.3


@pytest.mark.usefixtures("opengl")
def test_a_robot_that_is_put_elsewhere_looks_the_same(make_policy):
    player = Player(make_policy("ant"), (0.5, 0.5))
    following = FollowingCamera(player.model, 4 / 3)
    with Scene(player.model, 120, 90) as scene:
        following.restart(player.data)
        at_home = scene.draw(player.data, following.camera)
        player.env.physics.qpos[0, 0] += 40.0
        player.place()
        following.follow(player.data, player.env.dt)
        far_away = scene.draw(player.data, following.camera)
    difference = np.abs(at_home.astype(int) - far_away)
    assert np.median(difference) <= 2  # light and camera follow the robot


@pytest.mark.usefixtures("crowd")
@pytest.mark.parametrize(("task", "body"), [("crowd", "robot"), ("bowling", "ball")])
def test_cameras_show_the_robot_or_the_named_body(task, body, make_policy):
    env = Player(make_policy(task), (0.5, 0.5)).env
    data = mujoco.MjData(env.physics.model)
    mujoco.mj_forward(env.physics.model, data)
    place = data.body(body).xpos
    following = FollowingCamera(env.physics.model, 1.0, base=env.base)
    following.restart(data)
    np.testing.assert_allclose(following.camera.lookat, place, atol=0.2)
    take = Take(Player(make_policy(task), (0.5, 0.5)), 480, 360)
    assert take._camera.base == env.base
    assert Pictures(env, 64, 64)._camera.base == env.base
    (camera,) = cameras_for(env.physics.model, 1.0, [data], env.base)
    np.testing.assert_allclose(camera.lookat[:2], place[:2], atol=0.2)


@pytest.mark.usefixtures("opengl")
def test_a_custom_robot_needs_no_camera():
    model = mujoco.MjModel.from_xml_string(BALL)
    data = mujoco.MjData(model)
    data.qpos[0] = 50.0
    mujoco.mj_forward(model, data)
    following = FollowingCamera(model, 1.0)
    following.restart(data)
    with Scene(model, 1000, 700) as scene:  # more than the model's offscreen size
        picture = scene.draw(data, following.camera)
    assert picture.shape == (700, 1000, 3) and picture.dtype == np.uint8
    red = picture[..., 0].astype(int) > picture[..., 2].astype(int) + 50
    assert 0.1 < red.mean() < 0.6
    np.testing.assert_allclose(np.argwhere(red).mean(0), (350, 500), atol=60)


def test_without_opengl_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "none")
    with pytest.raises(MorlaxError, match=r"tried: none.*libegl1.*set MUJOCO_GL"):
        choose_opengl.__wrapped__()
