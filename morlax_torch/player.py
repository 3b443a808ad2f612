"""One robot to look at, moved by the policy of a trade-off that may change at any time."""

from collections.abc import Sequence

import mujoco
import torch

from . import envs
from .envs import Environment, MorlaxError, TimeStep
from .policy import Policy


class Player:
    """A world of a policy's own task on C MuJoCo, stepped by the deterministic policy.

    `tradeoff` may be set between steps, and so may `command` (C,), what the robot is told beside
    it, a number for each of its task's `command_limits`. Both last until set anew. `data` holds the
    robot as it stands now, every body and geom in its place, for a renderer to draw, and the forces
    of its motors; write to `env.physics` to move it. `returns` (m,) and `steps` count from the last
    reset, which is the caller's to make (`over` says when).
    """

    def __init__(self, policy: Policy, tradeoff: Sequence[float], seed: int = 0):
        self.policy = policy
        env = envs.make(
            policy.config.env,
            1,
            "cpu",
            "mujoco",
            seed,
            auto_reset=False,
            **policy.config.task.judged().model_dump(),
        )
        if not isinstance(env, Environment):
            raise MorlaxError(f"{policy.config.env} has no robot to show: only MuJoCo tasks have.")
        self.env = env
        self.model = self.env.physics.model
        self.data = mujoco.MjData(self.model)
        self.tradeoff = tradeoff
        self.command = env.command[0].tolist() if env.command_limits else []
        self.reset()

    @property
    def tradeoff(self) -> torch.Tensor:
        """(m,) not negative; need not sum to one."""
        return self._tradeoff

    @tradeoff.setter
    def tradeoff(self, tradeoff: Sequence[float]) -> None:
        self._network = self.policy.specialize(tradeoff)
        self._tradeoff = torch.as_tensor(tradeoff, dtype=torch.float32)

    def reset(self) -> None:
        """Start a new episode."""
        self.observation = self.env.reset()
        self.returns = torch.zeros(len(self.env.objectives))
        self.steps, self.over = 0, False
        self.place()

    def step(self) -> TimeStep:
        """One control step of `env.dt` seconds."""
        if self.command:
            self.env.command[0] = torch.tensor(self.command)
        step = self.env.step(self._network(self.observation))
        self.observation = step.observation
        self.returns += step.reward[0]
        self.steps += 1
        self.over = bool(step.terminated | step.truncated)
        self.place()
        return step

    def place(self) -> None:
        """Bring `data` up to the state of `env.physics`."""
        self.data.qpos[:] = self.env.physics.qpos[0].numpy()
        self.data.qvel[:] = self.env.physics.qvel[0].numpy()
        self.data.ctrl[:] = self.env.physics.ctrl[0].numpy()
        mujoco.mj_forward(self.model, self.data)
