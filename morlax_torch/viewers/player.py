"""One robot for viewers, driven by the policy of a trade-off that can change at any time."""

from collections.abc import Sequence

import mujoco
import numpy as np
import torch
from numpy.typing import ArrayLike

from ..configuration.schedules import Schedule
from ..envs import TimeStep
from ..evaluation.evaluator import stride_of
from ..networks.policy import Policy

PUSH = 1.5  # m/s added to the robot's velocity by a push


class Player:
    """One world of the policy's task on C MuJoCo, driven by the deterministic policy.

    Set `tradeoff` and `command` (C,), numbers for the task's `command_limits`, between steps.
    `data` holds the current state for a renderer, and the motor forces; write to `env.physics` to
    move the robot. `ghost` holds the state that the robot should have, if it follows a motion.
    `schedule` is that of the trade-off, if it has one, which sets it while the robot `follows` it.
    `returns` (m,) and `steps` count from the last reset; reset if it is `over`.
    """

    def __init__(self, policy: Policy, tradeoff: Sequence[float] | Schedule, seed: int = 0):
        self.schedule = tradeoff if isinstance(tradeoff, Schedule) else None
        self.follows = self.schedule is not None
        self.open(policy, seed)
        self.tradeoff = tradeoff.at(0.0) if isinstance(tradeoff, Schedule) else tradeoff

    def open(self, policy: Policy, seed: int = 0) -> None:
        """Start an episode of a policy's robot; a trade-off must follow."""
        self.policy, self.env = policy, policy.make_robot(seed)
        self.model = self.env.physics.model
        self.data = mujoco.MjData(self.model)
        self.ghost = None if self.env.ghost() is None else mujoco.MjData(self.model)
        self.command = self.env.command[0].tolist() if self.env.command_limits else []
        self.reset()

    @property
    def tradeoff(self) -> tuple[float, ...]:
        """(m,), not negative; it need not sum to one."""
        return self._tradeoff

    @tradeoff.setter
    def tradeoff(self, tradeoff: ArrayLike) -> None:
        weights = np.asarray(tradeoff, dtype=np.float64).tolist()
        self._network, self._tradeoff = self.policy.specialize(weights), tuple(weights)

    def reset(self) -> None:
        self.observation = self.env.reset()
        self.returns = torch.zeros(len(self.env.objectives), dtype=torch.float32, device="cpu")
        self.steps, self.over = 0, False
        self.place()

    def step(self) -> TimeStep:
        """Take one control step of `env.dt` seconds."""
        if self.command:
            self.env.command[0] = torch.tensor(self.command, dtype=torch.float32)
        schedule = self.schedule if self.follows else None
        if schedule is not None and self.steps % stride_of(self.env.episode_length) == 0:
            self.tradeoff = schedule.at(self.steps * self.env.dt)
        step = self.env.step(self._network(self.observation))
        self.observation = step.observation
        self.returns += step.reward[0]
        self.steps += 1
        self.over = bool(step.terminated | step.truncated)
        self.place()
        return step

    def place(self) -> None:
        """Update `data` from the state of `env.physics`."""
        for name in ("qpos", "qvel", "ctrl", "act"):
            getattr(self.data, name)[:] = getattr(self.env.physics, name)[0].numpy()
        parts = self.env.physics.parts
        for name in parts.keys() & {"mocap_pos", "mocap_quat"}:
            getattr(self.data, name)[:] = parts[name][0][0].numpy()
        mujoco.mj_forward(self.model, self.data)
        if self.ghost is not None and (pose := self.env.ghost()) is not None:
            self.ghost.qpos[:] = pose.numpy()
            mujoco.mj_kinematics(self.model, self.ghost)
