"""BRUCE's task matches a slow reference that computes one world and one number at a time."""

import math
from itertools import pairwise
from math import comb

import mujoco
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from test_randomization import separate_models

from morlax_torch import MorlaxError, envs
from morlax_torch.envs.robots.bruce import model as bruce
from morlax_torch.envs.robots.bruce.reference import Library

DT, STEP, LATE, EARLY = 0.02, 0.4, 0.005, 0.01  # seconds
REACH = np.array([0.6] * 10 + [0.4] * 6)

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def library() -> Library:
    return Library.load()


def rotation(quat: Array) -> Rotation:
    return Rotation.from_quat(quat, scalar_first=True)


def of_angles(roll: float, pitch: float, yaw: float) -> Rotation:
    return Rotation.from_euler("XYZ", [roll, pitch, yaw])


def turned(xy: Array, yaw: float) -> Array:
    return Rotation.from_rotvec([0, 0, yaw]).apply([*xy, 0])[:2]


def curve(points: Array, s: float) -> Array:
    n = len(points) - 1
    return sum(comb(n, k) * s**k * (1 - s) ** (n - k) * points[k] for k in range(n + 1))


def behind(points: Array, s: float) -> Array:
    """Return the control points of the rest of the curve after s, p(s + u (1 - s)), by a fit."""
    u = np.linspace(0, 1, len(points))
    n = len(points) - 1
    B = np.array([[comb(n, k) * x**k * (1 - x) ** (n - k) for k in range(n + 1)] for x in u])
    return np.linalg.solve(B, np.array([curve(points, s + x * (1 - s)) for x in u]))


class World:
    """The task state of one world, in absolute time."""

    def __init__(self, library: Library, command: Array, leg: int, qpos: Array, sensors: Array):
        self.library, self.command, self.leg = library, command, leg
        self.t, self.start, self.step_start, self.length = 0.0, -EARLY, -EARLY, STEP
        self.velocity, self.points = command, self.gait(command)
        self.offset, self.shift = np.zeros(16), np.zeros(2)
        first = curve(self.points[leg], 0.0)
        self.anchor = self.anchored(first, qpos)
        self.former_anchor = self.anchor
        asked, seen, joints = self.asked(), self.seen(qpos), self.joints(qpos)
        self.gyro, self.accelerometer = [sensors[:3]] * 5, [sensors[3:6]] * 5
        self.actions = [np.zeros(18)] * 5
        self.seen_history, self.joint_history = [seen] * 5, [joints] * 3
        self.asked_history = [asked] * 5

    def gait(self, v: Array) -> Array:
        def point(i: int, j: int) -> Array:
            library = self.library
            return np.concatenate([library.joints[i, j], library.base[i, j]], -1).astype(float)

        i, j = min(int((v[0] + 0.2) / 0.025), 15), min(int((v[1] + 0.1) / 0.025), 7)
        a = (v[0] - self.library.vx[i]) / 0.025
        b = (v[1] - self.library.vy[j]) / 0.025
        near = (1 - a) * point(i, j) + a * point(i + 1, j)
        far = (1 - a) * point(i, j + 1) + a * point(i + 1, j + 1)
        return (1 - b) * near + b * far

    def asked(self) -> Array:
        s = min(max((self.t - self.start) / self.length, 0.0), 1.0)
        return curve(self.points[self.leg], s)

    def rates(self) -> Array:
        s, h = min((self.t - self.start) / self.length, 1 - 1e-6), 1e-6
        points = self.points[self.leg]
        return (curve(points, s + h) - curve(points, s - h)) / (2 * h * self.length)

    def anchored(self, asked: Array, qpos: Array) -> Array:
        yaw = (of_angles(*asked[19:22]).inv() * rotation(qpos[3:7])).as_euler("ZYX")[0]
        return np.array([*(qpos[:2] - turned(asked[16:18], yaw)), yaw])

    def joints(self, qpos: Array) -> Array:
        right, left, arms = qpos[7:16], qpos[16:25], qpos[25:31]
        legs = []
        for yaw, _, _, knee, _, _, crank, a, b in (right, left):
            legs += [yaw, (b - a) / 2, -(a + b) / 2, knee, crank]
        return np.array([*legs, *arms])

    def seen(self, qpos: Array) -> Array:
        attitude = of_angles(0, 0, -self.anchor[2]) * rotation(qpos[3:7])
        upright = attitude.as_quat(canonical=True, scalar_first=True)
        return np.concatenate([upright, self.joints(qpos)])

    def control(self, action: Array) -> Array:
        """Return motor targets in the order of the motors."""
        self.offset = self.offset + DT / 0.03 * (REACH * action[:16] - self.offset)
        self.shift = self.shift + DT / 0.03 * (0.05 * action[16:] - self.shift)
        target = np.clip(self.command + self.shift, [-0.2, -0.1], [0.2, 0.1])
        if (self.t - self.step_start) / STEP < 0.7:
            z = (self.t - self.start) / self.length
            rest = self.length * (1 - z)
            wanted = self.gait(target)
            for leg in (0, 1):
                old = behind(self.points[leg], z)
                new = behind(wanted[leg], 1 - rest / STEP)
                self.points[leg, :3], self.points[leg, 5:] = old[:3], new[5:]
                self.points[leg, 3:5] = (old[3:5] + new[3:5]) / 2
            self.length, self.start, self.velocity = rest, self.t, target
        self.actions = [action, *self.actions[:-1]]
        crank = bruce.DEFAULT_POSE + self.offset
        motors = crank.copy()
        for leg in (0, 5):
            pitch, roll = crank[leg + 1 : leg + 3]
            motors[leg + 1 : leg + 3] = -(pitch + roll), pitch - roll
        return motors

    def follow(self, qpos: Array, sensors: Array) -> None:
        """Update the task state after a control step of the physics."""
        self.t += DT
        self.former_anchor = self.anchor
        if (self.t - self.start) / self.length >= 1:
            self.points, self.leg = self.gait(self.velocity), 1 - self.leg
            self.length, self.start = STEP, self.t - LATE
            self.step_start = self.start
            self.anchor = self.anchored(self.asked(), qpos)
        self.gyro = [sensors[:3], *self.gyro[:-1]]
        self.accelerometer = [sensors[3:6], *self.accelerometer[:-1]]
        self.seen_history = [self.seen(qpos), *self.seen_history[:-1]]
        self.joint_history = [self.joints(qpos), *self.joint_history[:-1]]
        self.asked_history = [self.asked(), *self.asked_history[:-1]]

    def phase(self) -> float:
        return (self.t - self.step_start) / STEP

    def observation(self) -> Array:
        base = [
            np.array([*a[16:19], *of_angles(*a[19:22]).as_quat(scalar_first=True)])
            for a in self.asked_history
        ]
        parts = [*self.gyro, *self.accelerometer, self.rates(), [self.leg, self.phase()]]
        parts += [*self.actions, self.command, *self.seen_history]
        return np.concatenate([*parts, *(a[:16] for a in self.asked_history), *base])

    def rewards(self, qpos: Array, torques: Array) -> Array:
        """Return the reward (6,) per objective."""
        asked = self.asked_history[1]
        x, y, yaw = self.former_anchor
        position = np.array([x, y, asked[18]])
        position[:2] += turned(asked[16:18], yaw)
        attitude = of_angles(0, 0, yaw) * of_angles(*asked[19:22])
        angle = (attitude.inv() * rotation(qpos[3:7])).magnitude()
        q, q1, q2 = self.joint_history
        a, a1, a2 = (action[:16] * REACH for action in self.actions[:3])
        c = math.cos(math.pi * (self.phase() + self.leg))
        swing = np.array([-0.4 * c, 1, 0.3 * (1 - c), -0.4 * c, -1, -0.3 * (1 + c)])
        shift, shift1 = (0.05 * action[16:] for action in self.actions[:2])
        norm = np.linalg.norm

        def near(difference: Array, width: float) -> float:
            return math.exp(-(norm(difference) ** 2) / width)

        shared = 0.85 * near(shift, 0.001) + 0.2 * near(shift - shift1, 0.002)
        smooth = 0.75 * (1 - norm(a - a1) - norm(a - 2 * a1 + a2))
        smooth += 4 * (0.2 - norm(q - q1) - norm(q - 2 * q1 + q2))
        return shared + np.array(
            [
                near(q[:10] - asked[:10], 0.15),
                near(qpos[:3] - position, 0.004) + math.exp(-(angle**2) / 0.02),
                near(q[10:] - swing, 0.15),
                near(q[10:] - [0, 1, 0, 0, -1, 0], 0.15),
                smooth,
                0.02 * max(54 - (torques**2).sum(), 0.0),
            ]
        )


@pytest.mark.slow
def test_every_world_matches_the_slow_reference(library):
    worlds, steps = 6, 132  # 6 foot exchanges; fallen robots keep going
    env = envs.make("bruce", worlds, "cpu", "mujoco", auto_reset=False, draw_commands=True)
    observation, physics = env.reset(), env.physics
    slow = [
        World(library, c, int(leg), q, s)
        for c, leg, q, s in zip(
            env.command.numpy().copy(),
            env.reference.leg,
            physics.qpos.numpy().copy(),
            physics.sensors.numpy().copy(),
            strict=True,
        )
    ]
    assert any((world.command == 0).all() for world in slow)
    assert {world.leg for world in slow} == {0, 1}
    random = np.random.default_rng(0)
    for time in range(steps):
        for i, world in enumerate(slow):
            np.testing.assert_allclose(observation[i], world.observation(), rtol=1e-6, atol=1e-5)
        action = random.uniform(-1, 1, (worlds, 18)) * ([0.15] * 16 + [1.0] * 2)
        ctrl = [world.control(a) for world, a in zip(slow, action, strict=True)]
        step = env.step(torch.from_numpy(action))
        np.testing.assert_allclose(physics.ctrl[:, :16], ctrl, atol=1e-9)
        assert (physics.ctrl[:, 16:] == 0).all()
        observation = step.observation
        for i, world in enumerate(slow):
            qpos, sensors = physics.qpos[i].numpy().copy(), physics.sensors[i].numpy().copy()
            world.follow(qpos, sensors)
            expected = world.rewards(qpos, sensors[6:])
            np.testing.assert_allclose(step.reward[i], expected, atol=1e-5, err_msg=f"{time}")
    assert all(world.leg == int(leg) for world, leg in zip(slow, env.reference.leg, strict=True))


def test_noise_stays_within_its_bounds(backend):
    exact = envs.make("bruce", 256, "cpu", backend)
    noisy = envs.make("bruce", 256, "cpu", backend, noise=1.0)
    difference = (noisy.reset() - exact.reset()).abs()
    gyro, accelerometer = difference[:, :3], difference[:, 15:18]
    seen = difference[:, 146:166]
    for values, width in ((gyro, 0.03), (accelerometer, 0.1), (seen[:, 4:], 0.02)):
        assert 0.9 * width < values.max() <= width * 1.001
    assert 0.01 < seen[:, 1:4].max() < 0.05
    assert (difference[:, 166:] == 0).sum() > 0  # the reference has no noise


def test_each_world_draws_a_new_command_each_episode(backend):
    env = envs.make("bruce", 64, "cpu", backend, draw_commands=True, episode_length=2)
    first = env.command.clone()
    assert (first.abs() <= first.new_tensor([0.2, 0.1])).all()
    assert 0.15 < (first == 0).all(-1).float().mean() < 0.65
    steps = [env.step(torch.zeros(64, 18)) for _ in range(2)]
    assert steps[1].truncated.all()
    assert (env.command != first).any(-1).float().mean() > 0.5


def test_commands_are_drawn_within_limits_and_redrawn_every_n_steps():
    options = {"draw_commands": True, "fastest": (0.1, 0.0), "redraw_every": 3, "standing": 0.0}
    env = envs.make("bruce", 32, "cpu", auto_reset=False, **options)
    commanded = [env.command.clone()]
    for _ in range(7):
        step = env.step(torch.zeros(32, 18))
        commanded.append(env.command.clone())
        torch.testing.assert_close(step.observation[:, 144:146], env.command.float())
    changed = [bool((one != other).any()) for one, other in pairwise(commanded)]
    assert changed == [False, False, True, False, False, True, False]
    for commands in commanded:
        assert 0.08 < commands[:, 0].abs().max() <= 0.1 and not commands[:, 1].any()


def test_both_backends_and_both_models_give_similar_returns():
    returns = {}
    for chains in ("closed", "tree"):
        for backend in ("mujoco", "warp"):
            env = envs.make("bruce", 1, "cpu", backend, auto_reset=False, chains=chains)
            rewards = [env.step(torch.zeros(1, 18)).reward[0] for _ in range(30)]
            returns[chains, backend] = torch.stack(rewards).sum(0)
    closed, warp, tree, _ = (value for value in returns.values())
    torch.testing.assert_close(warp, closed, rtol=1e-3, atol=0.05)
    torch.testing.assert_close(tree, closed, rtol=0.1, atol=1.0)


def test_randomized_worlds_differ_within_the_published_bounds():
    env = envs.make("bruce", 256, "cpu", "mujoco", randomize=True)
    nominal, state = env.physics.model, env.state_dict()
    torso, floor = nominal.body("torso").id, nominal.geom("floor").id

    def field(name: str) -> Array:
        return state[f"model.{name}"].numpy()

    gains = nominal.actuator_gainprm[:, 0]
    factors = {
        "mass": (field("body_mass")[:, torso] / nominal.body_mass[torso], 0.3),
        "friction": (field("geom_friction")[:, floor, 0] / 1.0, 0.4),
        "gain": (field("actuator_gainprm")[:, :, 0] / gains, 0.2),
    }
    for name, (factor, width) in factors.items():
        off = np.abs(factor - 1)
        assert 0.8 * width < off.max() < width * 1.001, name
    shifts = np.abs(field("body_ipos") - nominal.body_ipos).max((0, 2))
    assert 0.04 < shifts[torso] < 0.0601
    assert 0.009 < shifts[2:].min() <= shifts[2:].max() < 0.0101
    others = field("body_mass")[:, np.arange(nominal.nbody) != torso]
    assert (others == others[0]).all()
    options = envs.get("bruce").Options(draw_commands=True, noise=1.0, randomize=True, standing=0.2)
    assert options.for_evaluation() == envs.get("bruce").Options()
    servo, damper = field("actuator_gainprm")[:, 0, 0], field("actuator_biasprm")[:, 0, 1]
    np.testing.assert_allclose(damper, -servo)  # gain and bias scale together


@pytest.mark.parametrize(("backend", "within"), (("mujoco", 1e-12), ("warp", 5e-5)))
def test_a_randomized_world_matches_its_own_model(backend, within):
    options = {"randomize": True, "solver_iterations": 20}  # enough for both to converge
    env = envs.make("bruce", 4, "cpu", backend, auto_reset=False, **options)
    models = separate_models(env)
    for _ in range(5):
        env.step(torch.zeros(4, 18))
    ends = []
    for world, model in enumerate(models):
        data = mujoco.MjData(model)
        data.qpos[:] = env.starts.states[0][0]
        data.qvel[:] = env.starts.states[1][0]
        data.ctrl[:] = env.physics.ctrl[world]
        mujoco.mj_step(model, data, nstep=25)
        ends.append(data.qpos.copy())
    np.testing.assert_allclose(env.physics.qpos, ends, atol=within)
    assert np.abs(ends[0] - ends[1]).max() > 5e-3


def test_observation_parts_have_unique_names_and_match_the_observation():
    env = envs.make("bruce", 1, "cpu", command=(0.1, -0.05))
    parts = env.layout()
    assert len({part.name for part in parts}) == len(parts)
    starts = dict(
        zip((p.name for p in parts), np.cumsum([0, *(p.size for p in parts)]), strict=False)
    )
    seen = env.reset()[0]
    assert seen[starts["command"] :][:2].tolist() == pytest.approx([0.1, -0.05])
    assert seen[starts["reference.phase"]] == pytest.approx(EARLY / STEP)
    joints = env.physics.qpos[0, 25:31]  # the arms
    for age in range(5):
        torch.testing.assert_close(seen[starts[f"joints.{age}_steps_ago"] :][10:16], joints.float())


def test_it_fails_below_20_cm_and_refuses_commands_beyond_the_gaits_and_noisy_starts():
    env = envs.make("bruce", 2, "cpu")
    env.physics.qpos[:, 2] = torch.tensor([0.201, 0.199])
    assert env.failed().tolist() == [False, True]
    with pytest.raises(MorlaxError, match=r"at most 0\.2 m/s forward and 0\.1 m/s sideways"):
        envs.make("bruce", 1, "cpu", command=(0.3, 0.0))
    with pytest.raises(MorlaxError, match="leave reset_noise at 0"):
        envs.make("bruce", 1, "cpu", reset_noise=0.1)
