"""Pictures show a large robot in view, and models without sky, light or floor film well."""

import mujoco
import numpy as np
import pytest

from morlax_torch import MorlaxError, load
from morlax_torch.adapters.gymnasium import Pictures
from morlax_torch.envs.worlds.trees import base_of
from morlax_torch.viewers.camera import FollowingCamera, cameras_for, reach, shown_geoms
from morlax_torch.viewers.filming.recording import Take
from morlax_torch.viewers.filming.rendering import Scene, choose_opengl
from morlax_torch.viewers.player import Player

ROBOTS = ("ant", "bruce", "cheetah", "cheetah3", "hopper", "humanoid", "walker")


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
    following, seen = filmed(player.model, player.data), []
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
    following = filmed(player.model, player.data)
    with Scene(player.model, 120, 90) as scene:
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


def test_without_opengl_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "none")
    with pytest.raises(MorlaxError, match=r"tried: none.*libegl1.*set MUJOCO_GL"):
        choose_opengl.__wrapped__()


CART_POLE = """
<mujoco>
  {head}
  <worldbody>
    {world}
    <geom name="rail" type="capsule" fromto="-2 0 0 2 0 0" size="0.02"/>
    <body>
      <joint name="slide" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.1 0.06 0.05" rgba="0.2 0.4 0.8 1" contype="0"/>
      <body>
        <joint name="pole" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.6" size="0.02" rgba="0.9 0.5 0.1 1" contype="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="slide" gear="20"/></actuator>
</mujoco>
"""


def built(world: str = "", head: str = "") -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(CART_POLE.format(world=world, head=head))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def filmed(model: mujoco.MjModel, data: mujoco.MjData, aspect: float = 4 / 3) -> FollowingCamera:
    following = FollowingCamera(model, aspect, base_of(model))
    following.restart(data)
    return following


def undecorated(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the picture of MuJoCo's own renderer."""
    with mujoco.Renderer(model, 120, 160) as renderer:
        renderer.update_scene(data, filmed(model, data).camera)
        return renderer.render()


def picture(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    with Scene(model, 160, 120) as scene:
        return scene.draw(data, filmed(model, data).camera).astype(float)


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("head", ("", '<visual><headlight active="0"/></visual>'))
@pytest.mark.parametrize("world", ("", '<geom type="plane" size="0 0 1" pos="0 0 -1"/>'))
def test_a_bare_model_films_bright_and_with_contrast(world, head):
    model, data = built(world, head)
    image = picture(model, data)
    light = image.mean(-1)
    assert 130 < light.mean() < 230  # of 255
    assert (light < 20).mean() < 0.01  # nothing is black
    sky, floor = image[:20].reshape(-1, 3), image[-20:].reshape(-1, 3)
    assert sky[:, 2].mean() > sky[:, 0].mean() + 20  # blue
    assert floor.std(0).max() > 4  # checkered
    pole = (image[..., 0] > image[..., 2] + 60).mean()
    assert pole > 0.01
    if not world:
        assert (undecorated(model, data).mean(-1) < 20).mean() > 0.8


@pytest.mark.usefixtures("opengl")
def test_looks_change_neither_model_nor_motion():
    def motion(shown: bool) -> np.ndarray:
        model, data = built()
        following, states = filmed(model, data), []
        scene = Scene(model, 800, 600) if shown else None  # more than the model's offscreen size
        for step in range(200):
            data.ctrl[0] = np.sin(0.05 * step)
            mujoco.mj_step(model, data)
            if scene and step % 20 == 0:
                following.follow(data, 0.02)
                assert scene.draw(data, following.camera).shape == (600, 800, 3)
            states.append(np.concatenate([data.qpos, data.qvel, data.qacc_warmstart]))
        if scene:
            scene.close()
        stored = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, stored)
        return np.append(np.stack(states), stored)

    np.testing.assert_array_equal(motion(True), motion(False))


OWN = """
<asset>
  <texture name="sky" type="skybox" builtin="flat" rgb1="0.6 0.1 0.1" width="16" height="16"/>
  <texture name="grass" type="2d" builtin="flat" rgb1="0.1 0.6 0.1" width="16" height="16"/>
  <material name="grass" texture="grass"/>
</asset>
"""


@pytest.mark.usefixtures("opengl")
def test_the_user_s_own_sky_light_and_floor_are_kept():
    light = '<light type="directional" dir="0 0 -1" diffuse="0.3 0.3 0.3"/>'
    floor = '<geom type="plane" size="0 0 1" pos="0 0 -1" material="grass"/>'
    model, data = built(light + floor, OWN)
    image = picture(model, data)
    assert image[0, 0, 0] > 3 * image[0, 0, 2]  # a red sky
    assert image[-1, 0, 1] > 3 * image[-1, 0, 2]  # a green floor
    model.stat.extent = reach(model, data)[1]  # what a film sets in its own copy
    np.testing.assert_array_equal(image, undecorated(model, data))


def test_the_camera_follows_a_fast_cart_and_shows_its_jumps():
    model, data = built()
    following = filmed(model, data)
    start = following.camera.lookat - data.subtree_com[following.base]
    for step in range(100):
        data.qpos[0] = 0.06 * step  # 3 m/s
        mujoco.mj_forward(model, data)
        following.follow(data, 0.02)
    gap = following.camera.lookat - data.subtree_com[following.base] - start
    np.testing.assert_allclose(gap, 0, atol=1e-9)
    data.subtree_com[:, 2] += 1.0
    following.follow(data, 0.02)
    assert 0.9 < data.subtree_com[following.base, 2] + start[2] - following.camera.lookat[2] < 1


def test_the_camera_moves_back_when_the_robot_stretches_and_skips_a_blown_up_state():
    model, data = built()
    following = filmed(model, data)
    before = following.camera.distance
    data.geom_xpos[-1, 2] += 0.5
    following.follow(data, 0.02)
    wide = following.camera.distance
    assert wide > 1.2 * before
    data.subtree_com[:] = np.nan
    following.follow(data, 0.02)
    assert following.camera.distance == wide


def test_geoms_are_shown_that_mujoco_draws():
    materials = '<material name="blue" rgba="0 0 1 1"/><material name="none" rgba="1 1 1 0"/>'
    world = (
        '<geom size="0.1" material="blue"/><geom size="0.1"/><geom size="0.1" material="none"/>'
        '<geom size="0.1" material="blue" rgba="0 1 0 0"/><geom size="0.1" group="3"/>'
    )
    model, data = built(world, f"<asset>{materials}</asset>")
    scene = mujoco.MjvScene(model, 100)
    camera, option = mujoco.MjvCamera(), mujoco.MjvOption()
    mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
    drawn = {g.objid for g in scene.geoms[: scene.ngeom] if g.objtype == mujoco.mjtObj.mjOBJ_GEOM}
    assert set(np.flatnonzero(shown_geoms(model))) == drawn
