"""BRUCE's task: walk at a commanded velocity, following a gait library, with six objectives."""

import math
from typing import Self

import mujoco
import numpy as np
import torch
from pydantic import Field, NonNegativeFloat, field_validator
from torch import Tensor
from torch.linalg import vector_norm

from ...physics.interface import Fields, Physics
from ...worlds.environment import Environment
from ...worlds.episodes import Start, Starts
from ...worlds.mujoco_robot import Part
from ...worlds.options import Count, Objectives, TaskOptions
from . import model as bruce
from .reference import BASE, JOINTS, POSITION, Library, Reference
from .rotations import mapped

SEEN = 5  # values of each history in the observation
HISTORIES = {
    "actions": (SEEN, 18),
    "gyro": (SEEN, 3),
    "accelerometer": (SEEN, 3),
    "measured": (SEEN, 20),  # attitude and joints, with noise
    "joints": (3, 16),  # without noise
    "asked_joints": (SEEN, 16),  # of the reference
    "asked_base": (SEEN, 7),  # of the reference
}
FASTEST = (0.2, 0.1)  # largest commands, m/s, forward and sideways
COMMANDS = 2048  # that episodes draw from
LAG = 0.03  # s, time constant of the action filter
LEG_REACH, ARM_REACH, VELOCITY_REACH = 0.6, 0.4, 0.05  # rad, rad and m/s, of an action of 1
RESTING_HEIGHT = 0.427  # m; the soles are 2 mm above the floor in the default pose
FALLEN = 0.2  # m; a robot with a lower base has fallen

# Half the width of uniform noise: rad/s, m/s^2, rad, rad.
GYRO_NOISE, ACCELEROMETER_NOISE, JOINT_NOISE, ATTITUDE_NOISE = 0.03, 0.1, 0.02, 0.05
MOST_ENERGY = 54.0  # (N m)^2: 0.9 of the squared force limits of the arm motors
WIDTHS = {  # of rewards exp(-|difference|^2 / width) for closeness
    "gait": 0.15,
    "base_position": 0.004,
    "base_attitude": 0.02,
    "arm_swing": 0.15,
    "arm_hold": 0.15,
    "shift_size": 0.001,
    "shift_rate": 0.002,
}
# Arm joints that swing with the opposite legs, in rad.
ARM_MIDDLE, ARM_SWING = (0.0, 1.0, 0.3, 0.0, -1.0, -0.3), (-0.4, 0.0, -0.3, -0.4, 0.0, -0.3)


class BruceOptions(TaskOptions):
    """The options of BRUCE; by default nothing is random."""

    objectives: Objectives = {
        "joints": {"gait": 1.0},
        "base": {"base_position": 1.0, "base_attitude": 1.0},
        "swing": {"arm_swing": 1.0},
        "rigid": {"arm_hold": 1.0},
        "smooth": {"action_smoothness": 0.75, "joint_smoothness": 4.0},
        "energy": {"energy": 0.02},
    }
    shared: dict[str, float] = {"shift_size": 0.85, "shift_rate": 0.2}
    nconmax: int = 24
    njmax: int = 96
    chains: bruce.Chains = "closed"
    """closed: as on the robot; tree: motors on tendons instead, faster and nearly the same."""
    feet: bruce.Feet = "equal"
    """equal, or published: the left foot is 20 mm shorter, and the robot drifts sideways."""
    command: tuple[float, float] = (0.12, 0.0)
    """Commanded velocity in m/s, forward (at most 0.2) and to the left (at most 0.1)."""
    draw_commands: bool = False
    """Draw a velocity for each episode, starting with either foot."""
    standing: float = Field(default=0.4, ge=0, le=1)
    """Share of drawn velocities that are zero."""
    fastest: tuple[float, float] = FASTEST
    """Limits of drawn velocities in m/s, forward or backward, and to either side."""
    redraw_every: Count | None = None
    """Control steps after which a new velocity is drawn within an episode (None: never)."""
    noise: NonNegativeFloat = 0.0
    """Scale of the uniform sensor noise (1: as published; 0: exact sensors)."""
    randomize: bool = False
    """Randomize torso mass, centers of mass, friction and motor gains per world, as published."""

    @field_validator("reset_noise")
    @classmethod
    def _starts_from_gaits(cls, noise: float) -> float:
        if noise:
            raise ValueError("BRUCE starts from states of its gaits: leave reset_noise at 0")
        return noise

    def for_evaluation(self) -> Self:
        names = ("draw_commands", "standing", "fastest", "redraw_every", "noise", "randomize")
        changes = {name: type(self).model_fields[name].default for name in names}
        return super().for_evaluation().model_copy(update=changes)

    @field_validator("command", "fastest")
    @classmethod
    def _within_reach(cls, velocity: tuple[float, float]) -> tuple[float, float]:
        if any(abs(v) > most for v, most in zip(velocity, FASTEST, strict=True)):
            raise ValueError("use at most 0.2 m/s forward and 0.1 m/s sideways: no gait is faster")
        return velocity


class Bruce(Environment):
    """BRUCE, rewarded for following a reference walk.

    Actions move the joints about the default pose, independently of the reference. Two more numbers
    of the action shift the velocity of the reference. At each change of feet, the reference is
    moved to the robot, so drift is not penalized. Rewards compare with the reference of the
    previous control step, as observations do.
    """

    model_file = "bruce.xml"
    substeps = 5
    command_limits = {
        name: (-most, most)
        for name, most in zip(("m/s forward", "m/s to the left"), FASTEST, strict=True)
    }

    Options = BruceOptions
    options: BruceOptions
    titles = {
        "joints": "joint tracking",
        "base": "base tracking",
        "swing": "arm swing",
        "rigid": "still arms",
        "smooth": "smoothness",
        "energy": "energy saved",
    }

    def __init__(
        self, physics: Physics, options: BruceOptions, seed: int = 0, auto_reset: bool = True
    ):
        like, model = physics.qpos, physics.model
        self._library = Library.load()
        self.reference = Reference(self._library, like)
        self.command = like.new_zeros(len(like), 2)
        self._expand = bruce.joints_from_crank(model)
        self._from_joints = torch.from_numpy(bruce.crank_from_joints(model)).to(like)
        self._to_motors = torch.from_numpy(bruce.from_crank(bruce.MOTORS)).to(like)
        self._default = torch.from_numpy(bruce.DEFAULT_POSE).to(like)
        legs = bruce.NUM_LEG_JOINTS
        reach = [LEG_REACH] * legs + [ARM_REACH] * (16 - legs) + [VELOCITY_REACH] * 2
        self._reach = like.new_tensor(reach)
        self._fastest = like.new_tensor(FASTEST)
        self._widths = like.new_tensor(list(WIDTHS.values()))
        self._arm_middle, self._arm_swing = map(like.new_tensor, (ARM_MIDDLE, ARM_SWING))
        # The action of this control step, until it is pushed, and the filtered one. They share
        # memory, because nothing needs to save the former.
        self._action, self._filtered = like.new_zeros(2, len(like), 18)
        # Filtered offset from the default pose in rad, and shift of the velocity in m/s.
        self._offset, self._shift = self._filtered.split([16, 2], -1)
        self._rates = like.new_zeros(len(like), 22)  # of the reference
        # Latest values (N, K, C), newest first. All are views of one buffer, so that one operation
        # pushes or refills them.
        widths = [length * channels for length, channels in HISTORIES.values()]
        self._past = like.new_zeros(len(like), sum(widths))
        parts = zip(HISTORIES.items(), self._past.split(widths, -1), strict=True)
        self._histories = {name: part.unflatten(-1, size) for (name, size), part in parts}
        super().__init__(physics, options, seed, auto_reset)

    @classmethod
    def model_for(cls, options: BruceOptions) -> mujoco.MjModel:
        return bruce.load(options.chains, options.feet)

    def initial_qpos(self) -> np.ndarray:
        qpos = np.zeros(self.physics.model.nq)
        qpos[2:4] = RESTING_HEIGHT, 1.0
        qpos[7:] = self._expand @ bruce.DEFAULT_POSE
        return qpos

    def prepare_starts(self, seed: int) -> Starts:
        options, random = self.options, np.random.default_rng(seed)
        commands, legs, heights = np.array([options.command]), np.zeros(1, np.int64), np.ones(1)
        if options.draw_commands:
            commands = random.uniform(-1, 1, (COMMANDS, 2)) * options.fastest
            commands[random.random(COMMANDS) < options.standing] = 0.0
            legs, heights = random.integers(0, 2, COMMANDS), random.uniform(1.0, 1.02, COMMANDS)
        velocity, leg = torch.from_numpy(commands), torch.from_numpy(legs)
        walk, everywhere = Reference(self._library, velocity), torch.ones_like(leg).bool()
        anchors = velocity.new_zeros(len(velocity), 3)
        walk.begin(everywhere, velocity, leg, walk.gaits(velocity, leg), anchors)
        first = walk.points, *walk.now()
        walk.elapsed.zero_()
        poses, rates = (t.numpy() for t in walk.now())
        standing = (commands == 0).all(-1)
        anchors[standing, :2] = -torch.from_numpy(poses[standing, POSITION][:, :2])
        device, like = self.physics.device, self.physics.qpos
        self._first = velocity.to(like), leg.to(device), *(x.to(like) for x in (anchors, *first))
        rest, number, model = self.initial_qpos(), len(poses), self.physics.model
        poses[standing, POSITION] = np.outer(heights, rest[:3])[standing]
        poses[standing, JOINTS], rates[standing] = bruce.DEFAULT_POSE, 0.0
        cranks, qpos = poses[:, JOINTS], np.tile(rest, (number, 1))
        qpos[:, :3], qpos[:, 7:] = poses[:, POSITION], cranks @ self._expand.T
        qvel, ctrl = np.zeros((number, model.nv)), np.zeros((number, model.nu))
        qvel[:, :3], qvel[:, 6:] = rates[:, POSITION], rates[:, JOINTS] @ self._expand.T
        ctrl[:, :16] = cranks @ bruce.from_crank(bruce.MOTORS).T
        return Starts(map(Start, qpos, qvel, ctrl), self.physics)

    def vary_model(self, seed: int) -> Fields:
        drawn = super().vary_model(seed)
        if not self.options.randomize:
            return drawn
        return bruce.randomized(self.physics.model, drawn, self.draws.number, seed)

    def count_actions(self) -> int:
        return 16 + 2

    def begin(self, fresh: Tensor) -> None:
        rows, here = self.starts.rows, fresh[:, None]
        command, leg, anchor, points, target, rates = (values[rows] for values in self._first)
        torch.where(here, command, self.command, out=self.command)
        self.reference.begin(fresh, command, leg, points, anchor)
        torch.where(here, rates, self._rates, out=self._rates)
        value = {"actions": torch.zeros_like(self._action), **self._readings(target)}
        pieces = [value[name] for name, old in self._histories.items() for _ in range(old.shape[1])]
        torch.where(here, torch.cat(pieces, -1), self._past, out=self._past)

    def apply(self, action: Tensor) -> None:
        self._action.copy_(action.clamp(-1, 1))
        self._filtered.lerp_(self._reach * self._action, self.dt / LAG)
        self.physics.ctrl[:, :16] = mapped(self._to_motors, self._default + self._offset)

    def advance(self) -> None:
        velocity = torch.clamp(self.command + self._shift, -self._fastest, self._fastest)
        changed = self.reference.advance(velocity, self.dt)
        target, rates = self.reference.now()
        self._rates.copy_(rates)
        self.reference.follow(changed, target[:, BASE], self.physics.qpos[:, :7])
        newest, pieces = {"actions": self._action, **self._readings(target)}, []
        for name, values in self._histories.items():
            pieces += [newest[name], values[:, :-1].flatten(1)]
        self._past.copy_(torch.cat(pieces, -1))
        if self.options.draw_commands and (every := self.options.redraw_every):
            due = (self.age + 1) % every == 0  # age does not count this step yet
            rows, (commands, *_) = torch.empty_like(self.starts.rows), self._first
            self.draws.integers_(rows, 0, len(commands))
            torch.where(due[:, None], commands[rows], self.command, out=self.command)

    def _readings(self, target: Tensor) -> dict[str, Tensor]:
        """Return the next value (N, C) of each history but the actions; sensors include noise."""
        qpos, sensors = self.physics.qpos, self.physics.sensors
        tilt = self._noisy(torch.zeros_like(qpos[:, :3]), ATTITUDE_NOISE)
        gyro = self._noisy(sensors[:, :3], GYRO_NOISE)
        accelerometer = self._noisy(sensors[:, 3:6], ACCELEROMETER_NOISE)
        joints = mapped(self._from_joints, qpos[:, 7:])
        seen = [self.reference.seen_from(qpos[:, 3:7], tilt), self._noisy(joints, JOINT_NOISE)]
        return {
            "gyro": gyro,
            "accelerometer": accelerometer,
            "measured": torch.cat(seen, -1),
            "joints": joints,
            "asked_joints": target[:, JOINTS],
            "asked_base": target[:, BASE],
        }

    def _noisy(self, exact: Tensor, width: float) -> Tensor:
        """Add uniform noise in [-width, width] times the option `noise`."""
        scale = self.options.noise * width
        if not scale:
            return exact
        return exact + self.draws.uniform_(torch.empty_like(exact), -scale, scale)

    def observe(self) -> Tensor:
        step = torch.stack([self.reference.leg.to(self.command), self.reference.phase], -1)
        past = {name: values.flatten(1) for name, values in self._histories.items()}
        motion = [past["gyro"], past["accelerometer"], self._rates, step]
        asked = [past["asked_joints"], past["asked_base"]]
        return torch.cat([*motion, past["actions"], self.command, past["measured"], *asked], -1)

    def layout(self) -> list[Part]:
        def seen(*parts: tuple[str, int, str]) -> list[Part]:
            return [
                Part(f"{name}.{age}_steps_ago", size, unit)
                for age in range(SEEN)
                for name, size, unit in parts
            ]

        quaternion = "w, x, y, z"
        return [
            *seen(("gyro", 3, "rad/s, in the body")),
            *seen(("accelerometer", 3, "m/s², in the body")),
            Part("reference.velocity.joints", 16, "rad/s"),
            Part("reference.velocity.base", 3, "m/s, in the stance foot's frame"),
            Part("reference.velocity.angles", 3, "rad/s, of roll, pitch and yaw"),
            Part("reference.swinging_leg", 1, "0: left, 1: right"),
            Part("reference.phase", 1, "of the step, 0 to 1"),
            *seen(("action", 18, "")),
            Part("command", 2, "m/s, forward and to the left"),
            *seen(
                ("attitude", 4, f"{quaternion}, from the reference's heading"),
                ("joints", 16, "rad"),
            ),
            *seen(("reference.joints", 16, "rad")),
            *seen(
                ("reference.base", 3, "m, from the stance foot"),
                ("reference.attitude", 4, quaternion),
            ),
        ]

    def terms(self) -> dict[str, Tensor]:
        legs = bruce.NUM_LEG_JOINTS
        qpos, torques = self.physics.qpos, self.physics.sensors[:, 6:]
        past = self._histories
        joints, actions = past["joints"], self._reach * past["actions"]
        position, attitude = self.reference.placed(past["asked_base"][:, 1])
        overlap = (qpos[:, 3:7] * attitude).sum(-1).abs().clamp(max=1.0)
        arms = joints[:, 0, legs:]
        swing = torch.cos(math.pi * (self.reference.phase + self.reference.leg))[:, None]
        shift, former_shift = actions[:, 0, 16:], actions[:, 1, 16:]
        differences = {
            "gait": joints[:, 0, :legs] - past["asked_joints"][:, 1, :legs],
            "base_position": qpos[:, :3] - position,
            "base_attitude": 2 * torch.acos(overlap)[:, None],
            "arm_swing": arms - (self._arm_middle + swing * self._arm_swing),
            "arm_hold": arms - self._default[legs:],
            "shift_size": shift,
            "shift_rate": shift - former_shift,
        }
        distances = torch.stack([vector_norm(differences[x], dim=-1) for x in WIDTHS], -1)
        close = torch.exp(-distances.square() / self._widths)
        # the norms of the first and second difference of the newest value
        steps = torch.stack([actions[:, :3, :16], joints]).diff(dim=-2)
        bends = steps.diff(dim=-2)
        rough = vector_norm(steps[..., 0, :], dim=-1) + vector_norm(bends[..., 0, :], dim=-1)
        return {
            **dict(zip(WIDTHS, close.unbind(-1), strict=True)),
            "action_smoothness": 1.0 - rough[0],
            "joint_smoothness": 0.2 - rough[1],
            "energy": (MOST_ENERGY - torques.square().sum(-1)).clamp(min=0.0),
        }

    def failed(self) -> Tensor:
        return self.physics.qpos[:, 2] < FALLEN

    def initial_state(self) -> dict[str, Tensor]:
        return {
            "offset": self._offset,
            "shift": self._shift,
            "rates": self._rates,
            **{f"_{name}": values for name, values in self._histories.items()},
            **self.reference.state(),
        }
