"""One robot for viewers, driven by the policy of a trade-off that can change at any time."""

from collections.abc import Sequence

import mujoco
import torch

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
    `schedule` is that of the trade-off, if it has one. `returns` (m,) and `steps` count from the
    last reset; reset if it is `over`.
    """

    def __init__(self, policy: Policy, tradeoff: Sequence[float] | Schedule, seed: int = 0):
        self.policy, self.env = policy, policy.make_robot(seed)
        self.model = self.env.physics.model
        self.data = mujoco.MjData(self.model)
        self.ghost = None if self.env.ghost() is None else mujoco.MjData(self.model)
        self.tradeoff = tradeoff
        self.command = self.env.command[0].tolist() if self.env.command_limits else []
        self.reset()

    @property
    def tradeoff(self) -> torch.Tensor:
        """(m,), not negative; it need not sum to one. A schedule sets it at every time."""
        return self._tradeoff

    @tradeoff.setter
    def tradeoff(self, tradeoff: Sequence[float] | Schedule) -> None:
        self.schedule = tradeoff if isinstance(tradeoff, Schedule) else None
        self._use(tradeoff.at(0.0).tolist() if isinstance(tradeoff, Schedule) else tradeoff)

    def _use(self, tradeoff: Sequence[float]) -> None:
        self._network = self.policy.specialize(tradeoff)
        self._tradeoff = torch.as_tensor(tradeoff, dtype=torch.float32, device="cpu")

    def reset(self) -> None:
        self.observation = self.env.reset()
        self.returns = torch.zeros(len(self.env.objectives), dtype=torch.float32, device="cpu")
        self.steps, self.over = 0, False
        self.place()

    def step(self) -> TimeStep:
        """Take one control step of `env.dt` seconds."""
        if self.command:
            self.env.command[0] = torch.tensor(self.command, dtype=torch.float32)
        if self.schedule is not None and self.steps % stride_of(self.env.episode_length) == 0:
            self._use(self.schedule.at(self.steps * self.env.dt).tolist())
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
