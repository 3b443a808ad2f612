"""Both simulators match the reference trajectories and survive blow-ups."""

import math
import os

import mujoco
import numpy as np
import pytest
import torch
from acting import random_actions, still
from programs import Program
from same import reference

from morlax_torch import envs

BUILT_IN = [name for name in envs.names() if "/" not in name]
ROBOTS = ("cheetah", "walker", "hopper", "ant", "humanoid")
PLANAR = ("cheetah", "walker", "hopper")


def make(task: str, backend: str, worlds: int = 4, **options) -> envs.Environment:
    return envs.make(task, worlds, "cpu", backend=backend, **options)


def trajectory(env: envs.Environment, actions: np.ndarray, steps: int) -> np.ndarray:
    """Return positions (S, steps, nq) under the reference actions."""
    positions = []
    for action in torch.from_numpy(actions).float().unbind(1)[:steps]:
        env.step(action)
        positions.append(env.physics.qpos.clone())
    return torch.stack(positions, 1).numpy()


@pytest.mark.parametrize("robot", ROBOTS)
def test_with_the_paper_s_solver_limits_warp_starts_like_c_mujoco(robot):
    published = reference(robot)
    env = make(robot, "warp", 2, auto_reset=False)
    error = np.abs(trajectory(env, published["action"], 10) - published["qpos"][:, 1:11])
    assert error[:, 0].max() < 2e-6
    # walker's solver stops after two iterations, before it converges
    assert error.max() < (1e-2 if robot == "walker" else 1e-5)


@pytest.mark.parametrize("robot", ROBOTS)
def test_with_a_converged_solver_warp_matches_other_engines(robot):
    published = reference(robot)
    env = make(robot, "warp", 2, auto_reset=False, solver_iterations=100)
    found = trajectory(env, published["action"], 100)
    mjx, c = published["qpos_mjx_converged"], published["qpos_converged"][:, 1:101]
    assert np.abs(found - mjx).max() < (1e-2 if robot == "humanoid" else 1e-3)
    if robot in PLANAR:  # in 3D, C MuJoCo orients contact frames differently
        assert np.abs(found - c).max() < 1e-3


@pytest.mark.parametrize("robot", ROBOTS)
def test_warp_sensors_lag_like_those_of_c_mujoco(robot):
    warp, c = make(robot, "warp"), make(robot, "mujoco")
    for action in random_actions(c, 5):
        warp.step(action)
        c.step(action)
        torch.testing.assert_close(
            warp.physics.sensors.double(), c.physics.sensors, rtol=0, atol=1e-4
        )


def test_many_threads_match_a_single_loop():
    env = make("humanoid", "mujoco", 9, auto_reset=False)
    worlds = [mujoco.MjData(env.physics.model) for _ in range(env.num_worlds)]
    for world in worlds:
        world.qpos = env.initial_qpos()
    for action in random_actions(env, 60):
        env.step(action)
        for i, world in enumerate(worlds):
            world.ctrl = env.physics.ctrl[i]
            mujoco.mj_step(env.physics.model, world, nstep=env.substeps)
            assert (env.physics.qpos[i].numpy() == world.qpos).all()
            assert (env.physics.qvel[i].numpy() == world.qvel).all()
            assert (env.physics.warmstart[i].numpy() == world.qacc_warmstart).all()
            assert (env.physics.sensors[i].numpy() == world.sensordata).all()


def test_state_tensors_share_the_simulator_s_memory(backend):
    env = make("hopper", backend)
    physics = env.physics
    names = ("qpos", "qvel", "ctrl", "warmstart", "sensors")
    tensors = {name: getattr(physics, name) for name in names}
    before = physics.qpos.clone()
    env.step(still(env))
    assert not torch.equal(tensors["qpos"], before)

    physics.qvel[1, 0] += 1.0  # m/s along the track
    x = physics.qpos[:, 0].clone()
    env.step(still(env))
    assert (physics.qpos[1, 0] - x[1]).item() == pytest.approx(0.01, abs=1e-3)
    assert torch.equal(physics.qpos[2], physics.qpos[3])

    env.reset()
    for name, tensor in tensors.items():
        assert getattr(physics, name) is tensor, name


def test_a_sensor_is_a_view_of_the_readings(backend):
    env = make("humanoid", backend)
    env.step(still(env))
    head = env.physics.sensor("head")
    assert head.shape == (env.num_worlds, 3)
    assert 1.0 < head[0, 2] < 2.0  # meters: standing
    assert head.untyped_storage().data_ptr() == env.physics.sensors.untyped_storage().data_ptr()


# In a program of its own, since the memory of one that ran many tests may not fit twice
FORKED = """
import gc, multiprocessing
from morlax_torch import MorlaxError, envs
from morlax_torch.envs.physics.mujoco import Batch, PythonBatch

gc.disable()
env = envs.make("hopper", 4, "cpu", backend="mujoco")
actions = env.reset().new_zeros(4, env.action_size)

def step():
    try:
        env.step(actions)
    except MorlaxError as error:
        assert "cannot step worlds of its parent" in str(error)
    else:
        assert Batch is PythonBatch  # it has no threads

def fork(run):
    forked = multiprocessing.get_context("fork").Process(target=run)
    forked.start()
    forked.join(60)
    forked.kill()
    assert forked.exitcode == 0

fork(step)  # as a DataLoader's workers
env.itself = env  # a cycle, so that only the collector can free it
del env
fork(gc.collect)  # as AsyncVectorEnv's: threads of the garbage do not exist there
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows cannot fork")
def test_a_forked_process_neither_steps_nor_waits_for_its_parent_s_worlds(tmp_path):
    status, _, errors = Program(FORKED, tmp_path).ended(100)
    assert status == 0, errors


@pytest.mark.parametrize("task", BUILT_IN)
def test_a_blow_up_restarts_only_its_own_world(task, backend):
    sick, well = make(task, backend), make(task, backend)
    others = [0, 2, 3]
    length = 20
    start = sick.reset()
    beginning = []
    for time, action in enumerate(random_actions(sick, length).repeat(2, 1, 1)):
        if time == length - 1:
            sick.physics.qpos[1] = float("nan")
        step, expected = sick.step(action), well.step(action)
        beginning.append(expected.observation[1])
        if time == length - 1:
            assert step.terminated[1]
            assert not step.truncated[1]
            assert (step.reward[1] == 0).all()
            assert step.final_observation.isfinite().all()
            assert torch.equal(step.observation[1], start[1])
            assert sick.age[1] == 0
        if time >= length:  # the restarted world repeats its first episode
            assert torch.equal(step.observation[1], beginning[time - length])
        assert torch.equal(sick.physics.qpos[others], well.physics.qpos[others])
        assert torch.equal(sick.physics.qvel[others], well.physics.qvel[others])
        assert torch.equal(step.reward[others], expected.reward[others])
        assert torch.equal(step.terminated[others], expected.terminated[others])
    assert sick.blowups == 1
    assert well.blowups == 0


@pytest.mark.parametrize(
    ("tensor", "value"), [("qpos", math.nan), ("qvel", -math.inf), ("qvel", 1e5), ("qvel", 1e12)]
)
def test_a_number_that_is_huge_or_not_finite_is_a_blow_up_without_a_log(
    tensor, value, backend, workplace
):
    env = make("humanoid", backend)
    getattr(env.physics, tensor)[2, -1] = value
    step = env.step(still(env))
    assert step.terminated.tolist() == [False, False, True, False]
    assert env.blowups == 1
    for values in (step.reward, step.final_observation, *step.terms.values()):
        assert (values[2] == 0).all()
    assert step.observation.abs().max() < 100
    assert env.physics.qpos.isfinite().all() and env.physics.qvel.isfinite().all()
    env.physics.qpos[2, 2] = 1e30  # C MuJoCo also warns of huge numbers
    env.step(still(env))
    assert list(workplace.iterdir()) == []  # where MuJoCo logs its warnings


@pytest.mark.parametrize(
    ("buffers", "remedy"),
    [
        ({"njmax": 4}, "raise --task.njmax above 4 (constraint rows of a world)"),
        ({"nconmax": 1}, "raise --task.nconmax above 1 (contacts of a world)"),
    ],
)
def test_warp_reports_overflowing_buffers_and_the_remedy(buffers, remedy):
    env, unlimited = (make("cheetah", backend, 2, **buffers) for backend in ("warp", "mujoco"))
    env.step(still(env))
    assert (env.physics.overflow() == 0).all()  # the robot is in the air
    for _ in range(40):
        env.step(still(env))
        unlimited.step(still(env))
    bits = env.physics.overflow()
    assert bits.shape == (2,) and (bits != 0).all()
    assert env.physics.remedy(int(bits[0])) == remedy
    assert unlimited.physics.overflow().tolist() == [0, 0] and unlimited.physics.remedy(0) == ""


@pytest.mark.parametrize("task", BUILT_IN)
def test_default_buffers_suffice_for_random_actions(task):
    env = make(task, "warp", auto_reset=False)  # fallen robots have the most contacts
    for action in random_actions(env, 100):
        env.step(action)
    assert (env.physics.overflow() == 0).all()


def test_reaching_the_solver_iteration_limit_is_not_an_overflow():
    env = make("walker", "warp", solver_iterations=1)
    for action in random_actions(env, 40):
        env.step(action)
    assert (env.physics.overflow() == 0).all()
