"""Ported tasks of PG-MORL, COLA and MO-Gymnasium match the originals: robots, rewards, sight."""

import copy
import math
from collections.abc import Callable
from typing import NamedTuple

import gymnasium
import mo_gymnasium
import mujoco
import numpy as np
import pytest
import torch
from acting import random_actions

from morlax_torch import envs
from morlax_torch.envs.robots import MO_GYMNASIUM, PGMORL

TOLERANCE = 1e-9
SINGLE = 2e-6  # MO-Gymnasium's rewards are single precision
EPISODE = 80  # control steps: most robots have failed by then


def make(task: str, worlds: int = 2, backend: str = "mujoco", **options) -> envs.Environment:
    return envs.make(task, worlds, "cpu", backend, auto_reset=False, **options)


SEEN = "include_{}_in_observation"
BLIND = {SEEN.format(q): False for q in ("cinert", "cvel", "qfrc_actuator", "cfrc_ext")}
ORIGINS = {  # names and flags of the original environments
    "ant": ("mo-ant-v5", {}),
    "ant without forces": ("mo-ant-v5", {SEEN.format("cfrc_ext"): False}),
    "ant-2obj": ("mo-ant-2obj-v5", {}),
    "halfcheetah": ("mo-halfcheetah-v5", {}),
    "hopper": ("mo-hopper-v5", {}),
    "hopper-2obj": ("mo-hopper-2obj-v5", {}),
    "humanoid": ("mo-humanoid-v5", {}),
    "humanoid without bodies": ("mo-humanoid-v5", BLIND),
    "swimmer": ("mo-swimmer-v5", {}),
    "walker2d": ("mo-walker2d-v5", {}),
}


def open_original(name: str, env: envs.Environment, world: int = 0) -> gymnasium.Env:
    """Make MO-Gymnasium's environment and put it into the state of one world."""
    origin, flags = ORIGINS[name]
    original = mo_gymnasium.make(origin, **flags).unwrapped
    original.reset()
    original.model.opt.solver = env.physics.model.opt.solver  # its humanoid uses another solver
    original.set_state(env.physics.qpos[world].numpy(), env.physics.qvel[world].numpy())
    original.data.qacc_warmstart[:] = 0.0
    return original


def look_as_sensors_do(original: gymnasium.Env) -> None:
    """Compute derived quantities from the state before the last physics step, as sensors do.

    Gymnasium itself reads them after the RK4 integrator's last stage.
    """
    model, data = original.model, original.data

    def step(control: np.ndarray, substeps: int) -> None:
        data.ctrl[:] = control
        mujoco.mj_step(model, data, substeps - 1)
        entering = copy.copy(data)
        mujoco.mj_forward(model, entering)
        mujoco.mj_rnePostConstraint(model, entering)
        mujoco.mj_step(model, data)
        for name in ("xipos", "cinert", "cvel", "qfrc_actuator", "cfrc_ext"):
            getattr(data, name)[:] = getattr(entering, name)
        if model.nq > model.nv:  # the ant's velocity is the difference of its positions
            data.xpos[1] = data.qpos[:3]

    original._step_mujoco_simulation = step


@pytest.mark.parametrize("name", ORIGINS)
def test_mo_gymnasium_tasks_match_the_originals_step_by_step(name):
    env = make(f"mo-gymnasium/{name.split()[0]}", **ORIGINS[name][1])
    originals = [open_original(name, env, world) for world in range(2)]
    seen = env.observe()
    for world, original in enumerate(originals):
        assert original.observation_space.shape == (env.observation_size,)
        assert original.reward_space.shape == (len(env.objectives),)
        assert original.dt == pytest.approx(env.dt)
        np.testing.assert_allclose(seen[world], original._get_obs(), rtol=0, atol=1e-7)
        look_as_sensors_do(original)
    failures = 0
    for action in random_actions(env, EPISODE):
        step = env.step(action)
        seen, reward = env.observe(), env.combine(step.terms)
        for world, original in enumerate(originals):
            control = env.physics.ctrl[world].numpy()
            expected, pay, terminated, _, _ = original.step(control)
            np.testing.assert_allclose(seen[world], expected, rtol=1e-7, atol=1e-7)
            np.testing.assert_allclose(reward[world], pay, rtol=SINGLE, atol=SINGLE)
            assert step.terminated[world] == terminated
            failures += terminated
    never = name.split()[0] in ("halfcheetah", "swimmer")
    assert failures == 0 if never else failures > 0


@pytest.mark.parametrize("name", ("ant", "hopper", "humanoid", "walker2d"))
def test_robots_fail_where_mo_gymnasium_is_unhealthy(name):
    env = make(f"mo-gymnasium/{name}", 200, reset_noise=0.2)
    original = open_original(name, env)
    generator = torch.Generator().manual_seed(0)
    height = 2 if name in ("ant", "humanoid") else 1
    env.physics.qpos[:, height] += torch.rand(200, generator=generator) * 2 - 1
    env.physics.qvel *= torch.rand(200, 1, generator=generator) * 500
    unhealthy = []
    for qpos, qvel in zip(env.physics.qpos.numpy(), env.physics.qvel.numpy(), strict=True):
        original.set_state(qpos, qvel)
        unhealthy.append(not original.is_healthy)
    assert 20 < sum(unhealthy) < 180
    assert env.failed().tolist() == unhealthy


@pytest.mark.parametrize("task", MO_GYMNASIUM)
def test_reference_points_bound_the_control_cost_of_an_episode(task):
    env = make(task, 1)
    most = np.square(env.physics.model.actuator_ctrlrange).max(1).sum() * env.episode_length
    point = dict(zip(env.objectives, env.reference_point, strict=True))
    assert point.pop("control", -most) == pytest.approx(-most)
    assert set(point.values()) == {-100.0}


class Moment(NamedTuple):
    """One world, before and after a control step."""

    before: np.ndarray  # (nq,)
    qpos: np.ndarray
    qvel: np.ndarray
    control: np.ndarray
    dt: float

    @property
    def speed(self) -> float:
        return (self.qpos[0] - self.before[0]) / self.dt

    @property
    def effort(self) -> float:
        return sum(float(u) ** 2 for u in self.control)


def halfcheetah(now: Moment) -> tuple[list[float], bool]:
    run = min(4.0, now.speed) + 1.0
    return [run, 4.0 - now.effort + 1.0], not abs(now.qpos[2]) < np.deg2rad(50)


def walker2d(now: Moment) -> tuple[list[float], bool]:
    done = not (0.8 < now.qpos[1] < 2.0 and -1.0 < now.qpos[2] < 1.0)
    return [now.speed + 1.0, 4.0 - now.effort + 1.0], done


def hopper(now: Moment) -> tuple[list[float], bool]:
    rest = 1.0 - 2e-4 * now.effort
    upright = now.qpos[1] > 0.4 and all(abs(q) < np.deg2rad(90) for q in now.qpos[2:6])
    return [1.5 * now.speed + rest, 12.0 * (now.qpos[1] - 1.25) + rest], not upright


def hopper3(now: Moment) -> tuple[list[float], bool]:
    _, done = hopper(now)
    jump = 12.0 * (now.qpos[1] - 1.25) + 1.0
    return [1.5 * now.speed + 1.0, jump, 4.0 - now.effort + 1.0], done


def ant(now: Moment) -> tuple[list[float], bool]:
    rest = 1.0 - 0.5 * now.effort
    return [now.speed + rest, (now.qpos[1] - now.before[1]) / now.dt + rest], False


def swimmer(now: Moment) -> tuple[list[float], bool]:
    return [now.speed, 0.3 - 0.15 * now.effort], False


def humanoid(now: Moment) -> tuple[list[float], bool]:
    done = now.qpos[2] < 1.0 or now.qpos[2] > 2.0
    return [1.25 * now.speed + 3.0, 3.0 - 4.0 * now.effort + 3.0], done


def spared(cost: float, *controls: float) -> float:
    return 4.0 - cost * float(np.mean(np.square(controls)))


def ant3(now: Moment) -> tuple[list[float], bool]:
    sideways = (now.qpos[1] - now.before[1]) / now.dt
    return [now.speed, sideways, 4.0 - 0.5 * now.effort], False


def ant4(now: Moment) -> tuple[list[float], bool]:
    return [now.speed + spared(4.0, *now.control[i : i + 2]) for i in (0, 2, 4, 6)], False


def ant5(now: Moment) -> tuple[list[float], bool]:
    return [now.speed, *(spared(4.0, *now.control[i : i + 2]) for i in (0, 2, 4, 6))], False


def halfcheetah5(now: Moment) -> tuple[list[float], bool]:
    _, done = halfcheetah(now)
    u, run, jump = now.control, 0.5 * now.speed + 1.0, 20.0 * now.qpos[1] + 1.0
    return [run, jump, *(spared(3.0, *pair) + 1.0 for pair in (u[[0, 3]], u[1:3], u[3:5]))], done


def hopper5(now: Moment) -> tuple[list[float], bool]:
    (run, jump, _), done = hopper3(now)
    return [run, jump, *(spared(3.0, control) + 1.0 for control in now.control)], done


FORMULAS: dict[str, Callable[[Moment], tuple[list[float], bool]]] = {
    "pgmorl/ant": ant,
    "pgmorl/halfcheetah": halfcheetah,
    "pgmorl/hopper": hopper,
    "pgmorl/hopper3": hopper3,
    "pgmorl/humanoid": humanoid,
    "pgmorl/swimmer": swimmer,
    "pgmorl/walker2d": walker2d,
    "cola/ant-3d": ant3,
    "cola/ant-4d": ant4,
    "cola/ant-5d": ant5,
    "cola/halfcheetah-5d": halfcheetah5,
    "cola/hopper-5d": hopper5,
}


@pytest.mark.parametrize("name", FORMULAS)
def test_rewards_and_failures_match_the_formulas(name):
    env = make(name)
    unobserved = 2 if any(robot in name for robot in ("ant", "humanoid", "swimmer")) else 1
    clipped = 10.0 if "hopper" in name or "walker2d" in name else math.inf
    for action in random_actions(env, EPISODE):
        centered = name == "pgmorl/humanoid"  # its reward uses the center of mass
        before = env.place().numpy().copy() if centered else env.physics.qpos.clone()
        step = env.step(action)
        reward, seen = env.combine(step.terms), env.observe().numpy()
        for world in range(2):
            qpos, qvel = env.physics.qpos[world].numpy(), env.physics.qvel[world].numpy()
            control = env.physics.ctrl[world].numpy()
            now = Moment(np.asarray(before[world]), qpos, qvel, control, env.dt)
            if centered:
                now = now._replace(qpos=np.concatenate([env.place()[world].numpy(), qpos[2:]]))
            expected, done = FORMULAS[name](now)
            np.testing.assert_allclose(reward[world], expected, rtol=0, atol=TOLERANCE)
            assert bool(step.terminated[world]) == done
            shown = np.concatenate([qpos[unobserved:], qvel.clip(-clipped, clipped)])
            np.testing.assert_array_equal(seen[world, : len(shown)], shown)


class Robot(NamedTuple):
    """The constants of a robot in PG-MORL's MJCF and code."""

    substeps: int
    timestep: float
    reach: tuple[float, ...]  # control limits
    gear: tuple[float, ...]
    damping: float | None  # of actuated joints; None: as in Gymnasium
    weight: float  # total mass relative to Gymnasium's robot, as MO-Gymnasium has it


ROBOTS = {
    "ant": Robot(5, 0.01, (1,) * 8, (100,) * 8, None, 1),
    "halfcheetah": Robot(5, 0.01, (1,) * 6, (120, 90, 60, 120, 60, 30), None, 1),
    "hopper": Robot(5, 0.002, (2, 2, 4), (200, 200, 300), 40, 1),
    "humanoid": Robot(
        5,
        0.003,
        (0.4,) * 17,
        (100, 100, 100, *(100, 100, 300, 200) * 2, *(25,) * 6),
        None,
        1,
    ),
    "swimmer": Robot(4, 0.01, (1, 1), (300, 300), None, 1),
    "walker2d": Robot(4, 0.002, (1,) * 6, (100,) * 6, 3, 1.5),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_pg_morl_robots_match_the_published_constants(name):
    robot, task = ROBOTS[name], envs.get(f"pgmorl/{name}")
    model = task.load_model()
    plain = envs.get(f"mo-gymnasium/{name}").load_model()
    assert (task.substeps, model.opt.timestep) == (robot.substeps, robot.timestep)
    assert model.opt.integrator == plain.opt.integrator
    np.testing.assert_allclose(model.actuator_ctrlrange, [[-r, r] for r in robot.reach])
    np.testing.assert_allclose(model.actuator_gear[:, 0], robot.gear)
    assert model.body_mass.sum() == pytest.approx(robot.weight * plain.body_mass.sum())
    motors = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    damping = plain.dof_damping[motors] if robot.damping is None else robot.damping
    np.testing.assert_allclose(model.dof_damping[motors], damping)
    np.testing.assert_allclose(model.dof_armature, plain.dof_armature)
    limited = np.zeros_like(plain.jnt_limited) if name == "hopper" else plain.jnt_limited
    np.testing.assert_array_equal(model.jnt_limited, limited)


# others only have other objectives
FOREIGN = [name for name in (*PGMORL, *MO_GYMNASIUM) if "2" not in name and "3" not in name]
FOREIGN += ["mo-gymnasium/walker2d", "pgmorl/walker2d"]


@pytest.mark.parametrize("task", FOREIGN[::2])  # each robot once
def test_both_simulators_agree_on_the_first_steps(task):
    c_mujoco, warp = make(task), make(task, backend="warp")
    np.testing.assert_allclose(c_mujoco.reset(), warp.reset(), rtol=1e-5, atol=1e-5)
    for action in random_actions(c_mujoco, 3):
        one, other = c_mujoco.step(action), warp.step(action)
        np.testing.assert_allclose(one.observation, other.observation, rtol=1e-4, atol=2e-4)
        np.testing.assert_allclose(one.reward, other.reward, rtol=1e-5, atol=1e-5)
        assert torch.equal(one.terminated, other.terminated)


@pytest.mark.parametrize("task", FOREIGN)
def test_random_motion_fits_contact_and_constraint_buffers(task):
    env = make(task, 1)
    model, options = env.physics.model, env.options
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    contacts, rows = [], []
    for step in range(800):  # fallen robots have the most contacts
        if step % 20 == 0:
            data.ctrl[:] = random.permuted(model.actuator_ctrlrange, axis=1)[:, 0]
        mujoco.mj_step(model, data)
        contacts.append(data.ncon)
        rows.append(data.nefc)
    assert max(contacts) < options.nconmax
    assert max(rows) < options.njmax
