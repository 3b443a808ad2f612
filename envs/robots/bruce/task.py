"""BRUCE's task: walk at a commanded velocity, following a gait library, with six objectives."""

import mujoco
import numpy as np
import torch
from torch import Tensor

from ...physics.interface import Physics
from ...worlds.environment import Environment
from ...worlds.episodes import Starts
from ...worlds.mujoco_robot import Part
from . import model as bruce
from .beginnings import FASTEST, Beginnings
from .gaits import Library
from .history import Histories
from .model import randomized
from .options import BruceOptions
from .reference import BASE, JOINTS, Anchor, Reference
from .rewards import Closeness, SwingingArms, roughness
from .rotations import PairSums

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
LAG = 0.03  # s, time constant of the action filter
LEG_REACH, ARM_REACH, VELOCITY_REACH = 0.6, 0.4, 0.05  # rad, rad and m/s, of an action of 1
RESTING_HEIGHT = 0.427  # m; the soles are 2 mm above the floor in the default pose
FALLEN = 0.2  # m; a robot with a lower base has fallen

# Half the width of uniform noise: rad/s, m/s^2, rad, rad.
GYRO_NOISE, ACCELEROMETER_NOISE, JOINT_NOISE, ATTITUDE_NOISE = 0.03, 0.1, 0.02, 0.05
MOST_ENERGY = 54.0  # (N m)^2: 0.9 of the squared force limits of the arm motors
WIDTHS = {  # of rewards for closeness
    "gait": 0.15,
    "base_position": 0.004,
    "base_attitude": 0.02,
    "arm_swing": 0.15,
    "arm_hold": 0.15,
    "shift_size": 0.001,
    "shift_rate": 0.002,
}


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
        reach = [LEG_REACH] * legs + [ARM_REACH] * (16 - legs) + [VELOCITY_REACH] * 2
        self._reach = like.new_tensor(reach)
        self._fastest = like.new_tensor(FASTEST)
        self._closeness, self._swinging_arms = Closeness(WIDTHS, like), SwingingArms(like)
        # The action of this control step, until it is pushed, and the filtered one. They share
        # memory, because nothing needs to save the former.
        self._action, self._filtered = like.new_zeros(2, len(like), 18)
        # Filtered offset from the default pose in rad, and shift of the velocity in m/s.
        self._offset, self._shift = self._filtered.split([16, 2], -1)
        self._anchor = Anchor(like)
        self._rates = like.new_zeros(len(like), 22)  # of the reference
        self._histories = Histories(like, HISTORIES)
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
        options = self.options
        if options.draw_commands:
            beginnings = Beginnings.drawn(options.fastest, options.standing, seed)
        else:
            beginnings = Beginnings.only(options.command)
        rest, model = self.initial_qpos(), self.physics.model
        states, self._first = beginnings.states(self._library, rest, model, self.physics.qpos)
        return Starts(states, self.physics)

    def vary_model(self, seed: int) -> dict[str, np.ndarray]:
        drawn = super().vary_model(seed)
        if not self.options.randomize:
            return drawn
        return randomized(self.physics.model, drawn, self.draws.number, seed)

    def count_actions(self) -> int:
        return 16 + 2

    def begin(self, fresh: Tensor) -> None:
        first, here = self._first.at(self.starts.rows), fresh[:, None]
        torch.where(here, first.command, self.command, out=self.command)
        self._anchor.begin(fresh, first.anchor)
        self.reference.begin(fresh, first.command, first.leg, first.points)
        torch.where(here, first.rates, self._rates, out=self._rates)
        no_action = torch.zeros_like(self._action)
        self._histories.refill(fresh, {"actions": no_action, **self._readings(first.target)})

    def apply(self, action: Tensor) -> None:
        self._action.copy_(action.clamp(-1, 1))
        self._filtered.lerp_(self._reach * self._action, self.dt / LAG)
        self.physics.ctrl[:, :16] = self._to_motors(self._default + self._offset)

    def advance(self) -> None:
        velocity = torch.clamp(self.command + self._shift, -self._fastest, self._fastest)
        changed = self.reference.advance(velocity, self.dt)
        target, rates = self.reference.now()
        self._rates.copy_(rates)
        self._anchor.advance(changed, target[:, BASE], self.physics.qpos[:, :7])
        self._histories.push({"actions": self._action, **self._readings(target)})
        if self.options.draw_commands and self.options.redraw_every:
            self._redraw(self.options.redraw_every)

    def _redraw(self, every: int) -> None:
        """Draw new commands in the worlds whose episode age reaches a multiple of `every` steps."""
        due = (self.age + 1) % every == 0  # age does not count this step yet
        rows = torch.empty_like(self.starts.rows)
        commands = self._first.command
        self.draws.integers_(rows, 0, len(commands))
        torch.where(due[:, None], commands[rows], self.command, out=self.command)

    def _readings(self, target: Tensor) -> dict[str, Tensor]:
        """Return the next value (N, C) of each history but the actions; sensors include noise."""
        qpos, sensors = self.physics.qpos, self.physics.sensors
        tilt = self._noisy(torch.zeros_like(qpos[:, :3]), ATTITUDE_NOISE)
        gyro = self._noisy(sensors[:, :3], GYRO_NOISE)
        accelerometer = self._noisy(sensors[:, 3:6], ACCELEROMETER_NOISE)
        joints = self._from_joints(qpos[:, 7:])
        seen = [self._anchor.seen_from(qpos[:, 3:7], tilt), self._noisy(joints, JOINT_NOISE)]
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
        reference = self.reference
        step = torch.stack([reference.leg.to(self.command), reference.phase], -1)

        def history(name: str) -> Tensor:
            return self._histories[name].flatten(1)

        return torch.cat(
            [
                history("gyro"),
                history("accelerometer"),
                self._rates,
                step,
                history("actions"),
                self.command,
                history("measured"),
                history("asked_joints"),
                history("asked_base"),
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
        qpos, torques = self.physics.qpos, self.physics.sensors[:, 6:]
        joints, actions = self._histories["joints"], self._reach * self._histories["actions"]
        target_joints = self._histories["asked_joints"][:, 1]
        position, attitude = self._anchor.placed(self._histories["asked_base"][:, 1])
        overlap = (qpos[:, 3:7] * attitude).sum(-1).abs().clamp(max=1.0)
        arms = joints[:, 0, legs:]
        swing = self._swinging_arms(self.reference.phase, self.reference.leg)
        shift, former_shift = actions[:, 0, 16:], actions[:, 1, 16:]
        close = self._closeness(
            {
                "gait": joints[:, 0, :legs] - target_joints[:, :legs],
                "base_position": qpos[:, :3] - position,
                "base_attitude": 2 * torch.acos(overlap)[:, None],
                "arm_swing": arms - swing,
                "arm_hold": arms - self._default[legs:],
                "shift_size": shift,
                "shift_rate": shift - former_shift,
            }
        )
        rough = roughness(torch.stack([actions[:, :3, :16], joints]))
        return {
            **close,
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
            **self._histories.state(),
            **self._anchor.state(),
            **self.reference.state(),
        }
