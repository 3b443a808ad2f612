"""Run BRUCE episodes by the paper's protocol.

The reward at the reset counts; steps after a fall do not.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from morlax_torch import envs
from morlax_torch.envs.robots.bruce import rotations
from morlax_torch.host.resources import one_thread
from morlax_torch.networks.policy import Policy

COMMAND = (0.12, 0.0)  # m/s forward and to the left
TORQUES = slice(6, None)  # columns of the robot's sensors

Array = NDArray[np.float64]


class Walks(NamedTuple):
    """Results of P policies, one episode each."""

    returns: Array  # (P, 6)
    survived: NDArray[np.bool_]  # (P,)
    commands: Array  # (P, 2) m/s
    speed: Array  # (P, 2) mean m/s forward and to the left of the robot, until a fall
    effort: Array  # (P,) (N m)², mean sum of squared torques until a fall


def walks(policy: Policy, tradeoffs: Tensor, chunk: int, **options: Any) -> Walks:
    """Run one episode per trade-off.

    Args:
        policy: the family of policies.
        tradeoffs: (P, 6).
        chunk: trade-offs to simulate at once.
        options: task options that replace the policy's own.
    """
    task = policy.config.task.for_evaluation().model_copy(update={"command": COMMAND, **options})
    parts = []
    for seed, some in enumerate(tradeoffs.split(chunk)):
        device = policy.agent.observation_normalizer.mean.device
        env = envs.make(
            "bruce", len(some), device, seed=seed, auto_reset=False, **task.model_dump()
        )
        parts.append(_walk(policy, some.to(device), env))
    return Walks(*map(np.concatenate, zip(*parts, strict=True)))


@torch.no_grad()
def _walk(policy: Policy, tradeoffs: Tensor, env: envs.Environment) -> Walks:
    qpos, qvel, torques = env.physics.qpos, env.physics.qvel, env.physics.sensors[:, TORQUES]
    act = policy.agent.policies(tradeoffs)
    seen = env.reset()
    commands = env.command.clone()
    returns = env.combine(env.terms())
    alive = torch.ones_like(tradeoffs[:, 0], dtype=torch.bool)
    path, effort, steps = torch.zeros_like(qvel[:, :2]), torch.zeros_like(qvel[:, 0]), 0 * alive
    with one_thread(env.device):
        for _ in range(env.episode_length):
            action = act(policy.agent.observation_normalizer(seen)[:, None]).mean[:, 0].tanh()
            step = env.step(action)
            seen = step.observation
            alive &= ~step.terminated
            returns += step.reward * alive[:, None]
            path += rotations.turned(qvel[:, :2], -rotations.yaw_of(qpos[:, 3:7])) * alive[:, None]
            effort += torques.square().sum(-1) * alive
            steps += alive
    made = steps.clamp(min=1)
    found = (returns, alive, commands, path / made[:, None], effort / made)
    return Walks(*(value.cpu().numpy() for value in found))
