"""BRUCE's task: walk at a commanded velocity, following a gait library, with six objectives."""

from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from ...physics.interface import Physics
from ...worlds.environment import Environment
from ...worlds.layout import Part
from ...worlds.starts import Starts
from . import model as bruce
from . import rotations
from .anchor import Anchor
from .beginnings import ANGLES, FASTEST, POSITION, Beginnings
from .history import History
from .library import Library
from .options import BruceOptions
from .pair_sums import PairSums
from .randomization import randomized
from .reference import Reference
from .rewards import closeness, roughness, swinging_arms

SEEN = 5  # values of each history in the observation
LAG = 0.03  # s, time constant of the action filter
LEG_REACH, ARM_REACH, VELOCITY_REACH = 0.6, 0.4, 0.05  # rad, rad and m/s, of an action of 1
RESTING_HEIGHT = 0.427  # m; the soles are 2 mm above the floor in the default pose
FALLEN = 0.2  # m; a robot with a lower base has fallen

# Half the width of uniform noise: rad/s, m/s^2, rad, rad.
GYRO_NOISE, ACCELEROMETER_NOISE, JOINT_NOISE, ATTITUDE_NOISE = 0.03, 0.1, 0.02, 0.05
MOST_ENERGY = 54.0  # (N m)^2: 0.9 of the squared force limits of the arm motors


class Bruce(Environment):
    """BRUCE, rewarded for following a reference walk.

    Actions move the joints about the default pose, independently of the reference. Two more numbers
    of the action shift the velocity of the reference. At each change of feet, the reference is
    moved to the robot, so drift is not penalized. Rewards compare with the reference of the
    previous control step, as observations do.
    """

    substeps = 5
    command_limits = {
        name: (-most, most)
        for name, most in zip(("m/s forward", "m/s to the left"), FASTEST, strict=True)
    }

    Options = BruceOptions
    options: BruceOptions

    def __init__(
        self, physics: Physics, options: BruceOptions, seed: int = 0, auto_reset: bool = True
    ):
        like, model = physics.qpos, physics.model
        self._library = Library.load()
        self.reference = Reference(self._library, like)
        self.command = like.new_zeros(len(like), 2)
        self._from_joints = PairSums(bruce.crank_from_joints(model), like)
        self._to_motors = PairSums(bruce.motors_from_crank(), like)
        self._default = torch.from_numpy(bruce.DEFAULT_POSE).to(like)
        legs = bruce.NUM_LEG_JOINTS
        self._reach = like.new_tensor([LEG_REACH] * legs + [ARM_REACH] * (16 - legs))
        self._fastest = like.new_tensor(FASTEST)
        self._offset = like.new_zeros(len(like), 16)  # rad, filtered offset from the default pose
        self._shift = like.new_zeros(len(like), 2)  # m/s, filtered velocity shift
        self._anchor = Anchor(like)
        self._rates = like.new_zeros(len(like), 22)  # of the reference
        # The names of these attributes are keys of saved states.
        self._actions = History(like, SEEN, 18)
        self._gyro, self._accelerometer = History(like, SEEN, 3), History(like, SEEN, 3)
        self._measured = History(like, SEEN, 20)  # attitude and joints, with noise
        self._joints = History(like, 3, 16)  # without noise
        self._asked_joints = History(like, SEEN, 16)  # of the reference
        self._asked_base = History(like, SEEN, 7)  # of the reference
        super().__init__(physics, options, seed, auto_reset)

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        return bruce.load()

    @classmethod
    def model_for(cls, options: BruceOptions) -> mujoco.MjModel:
        return bruce.load(options.chains, options.feet)

    def initial_qpos(self) -> np.ndarray:
        qpos = np.zeros(self.physics.model.nq)
        qpos[2:4] = RESTING_HEIGHT, 1.0
        qpos[7:] = bruce.joints_from_crank(self.physics.model) @ bruce.DEFAULT_POSE
        return qpos

    def prepare_starts(self, seed: int) -> Starts:
        options, like = self.options, self.physics.qpos
        if options.draw_commands:
            beginnings = Beginnings.drawn(options.fastest, options.standing, seed)
        else:
            beginnings = Beginnings.only(options.command)
        states, anchors = beginnings.states(self._library, self.initial_qpos(), self.physics.model)
        self._commands, self._anchors = beginnings.commands.to(like), anchors.to(like)
        self._legs = beginnings.legs.to(self.physics.device)
        return Starts(states, self.physics)

    def vary_model(self, seed: int) -> dict[str, np.ndarray]:
        drawn = super().vary_model(seed)
        if not self.options.randomize:
            return drawn
        return randomized(self.physics.model, drawn, self.num_worlds, seed)

    def count_actions(self) -> int:
        return 16 + 2

    def begin(self, fresh: Tensor) -> None:
        rows, here = self.starts.rows, fresh[:, None]
        self.command.copy_(torch.where(here, self._commands[rows], self.command))
        self._anchor.begin(fresh, self._anchors[rows])
        for filtered in (self._offset, self._shift):
            filtered.masked_fill_(here, 0.0)
        self.reference.begin(fresh, self.command, self._legs[rows])
        target, rates = self.reference.now()
        self._rates.copy_(torch.where(here, rates, self._rates))
        for history, value in self._readings(target):
            history.refill(fresh, value)
        self._actions.refill(fresh, torch.zeros_like(self._actions.values[:, 0]))

    def apply(self, action: Tensor) -> None:
        action = action.clamp(-1, 1).to(self._offset)
        self._offset.lerp_(self._reach * action[:, :16], self.dt / LAG)
        self._shift.lerp_(VELOCITY_REACH * action[:, 16:], self.dt / LAG)
        velocity = self.command + self._shift
        self.reference.blend(torch.clamp(velocity, -self._fastest, self._fastest))
        self._actions.push(action)
        self.physics.ctrl[:, :16] = self._to_motors(self._default + self._offset)

    def advance(self) -> None:
        changed = self.reference.advance(self.dt)
        target, rates = self.reference.now()
        self._rates.copy_(rates)
        self._anchor.advance(changed, target, self.physics.qpos[:, :7])
        for history, value in self._readings(target):
            history.push(value)
        if self.options.draw_commands and self.options.redraw_every:
            self._redraw(self.options.redraw_every)

    def _redraw(self, every: int) -> None:
        """Draw new commands in the worlds whose episode age reaches a multiple of `every` steps."""
        due = (self.age + 1) % every == 0  # age does not count this step yet
        rows = torch.empty_like(self.starts.rows)
        rows.random_(0, len(self._commands), generator=self.generator)
        self.command.copy_(torch.where(due[:, None], self._commands[rows], self.command))

    def _readings(self, target: Tensor) -> list[tuple[History, Tensor]]:
        """Return each history with its next value (N, C); sensors include noise."""
        qpos = self.physics.qpos
        joints = self._from_joints(qpos[:, 7:])
        attitude = self._anchor.seen_from(qpos[:, 3:7])
        tilt = rotations.from_angles(self._noisy(qpos[:, :3], ATTITUDE_NOISE))
        seen = rotations.positive(rotations.multiply(tilt, attitude))
        gyro, accelerometer = self.physics.sensors[:, :3], self.physics.sensors[:, 3:6]
        base = [target[:, POSITION], rotations.from_angles(target[:, ANGLES])]
        return [
            (self._gyro, gyro + self._noisy(gyro, GYRO_NOISE)),
            (
                self._accelerometer,
                accelerometer + self._noisy(accelerometer, ACCELEROMETER_NOISE),
            ),
            (self._measured, torch.cat([seen, joints + self._noisy(joints, JOINT_NOISE)], -1)),
            (self._joints, joints),
            (self._asked_joints, target[:, :16]),
            (self._asked_base, torch.cat(base, -1)),
        ]

    def _noisy(self, like: Tensor, width: float) -> Tensor:
        """Draw uniform noise in [-width, width] times the option `noise`, shaped like `like`."""
        scale = self.options.noise * width
        if not scale:
            return torch.zeros_like(like)
        return torch.empty_like(like).uniform_(-scale, scale, generator=self.generator)

    def observe(self) -> Tensor:
        reference = self.reference
        step = torch.stack([reference.leg.to(self.command), reference.phase], -1)
        return torch.cat(
            [
                self._gyro.values.flatten(1),
                self._accelerometer.values.flatten(1),
                self._rates,
                step,
                self._actions.values.flatten(1),
                self.command,
                self._measured.values.flatten(1),
                self._asked_joints.values.flatten(1),
                self._asked_base.values.flatten(1),
            ],
            -1,
        )

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
        joints = self._joints.values[:, 0]
        target_joints, target_base = self._asked_joints.values[:, 1], self._asked_base.values[:, 1]
        position, attitude = self._anchor.placed(target_base)
        overlap = (self.physics.qpos[:, 3:7] * attitude).sum(-1).abs().clamp(max=1.0)
        arms = joints[:, legs:]
        swing = swinging_arms(self.reference.phase, self.reference.leg)
        torques = self.physics.sensors[:, 6:]
        shift, former_shift = (VELOCITY_REACH * self._actions.values[:, k, 16:] for k in (0, 1))
        return {
            "gait": closeness(joints[:, :legs] - target_joints[:, :legs], 0.15),
            "base_position": closeness(self.physics.qpos[:, :3] - position, 0.004),
            "base_attitude": closeness(2 * torch.acos(overlap)[:, None], 0.02),
            "arm_swing": closeness(arms - swing, 0.15),
            "arm_hold": closeness(arms - self._default[legs:], 0.15),
            "action_smoothness": 1.0 - roughness(self._reach * self._actions.values[..., :16]),
            "joint_smoothness": 0.2 - roughness(self._joints.values),
            "energy": (MOST_ENERGY - torques.square().sum(-1)).clamp(min=0.0),
            "shift_size": closeness(shift, 0.001),
            "shift_rate": closeness(shift - former_shift, 0.002),
        }

    def failed(self) -> Tensor:
        return self.physics.qpos[:, 2] < FALLEN

    def _state(self) -> dict[str, Tensor]:
        histories = {
            name: value.values for name, value in vars(self).items() if isinstance(value, History)
        }
        own: dict[str, Any] = {
            "command": self.command,
            "offset": self._offset,
            "shift": self._shift,
            "rates": self._rates,
            "starts": self.starts.rows,
        }
        return {
            **super()._state(),
            **own,
            **histories,
            **self._anchor.state(),
            **self.reference.state(),
        }
