r"""A planar arm with two goals: a robot with a concave Pareto front.

morlax train --env docs/examples/two_goals.py:TwoGoals \
    --scalarization augmented-chebyshev --network.max-std 0.2
"""

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from morlax_torch.envs import Environment, Part, TaskOptions, positions, velocities

LINK = 0.2  # m
WIDTH = 0.12  # m, of a goal


def joint_angles(fingertip: np.ndarray) -> np.ndarray:
    """Return the joint angles (..., 2) in rad that put the fingertip (..., 2) in m."""
    x, y = np.moveaxis(fingertip, -1, 0)
    half = np.arccos(np.hypot(x, y) / (2 * LINK))
    return np.stack([np.arctan2(y, x) - half, 2 * half], -1)


def nearness(fingertip: Tensor, goals: Tensor) -> Tensor:
    """Return exp(-distance² / WIDTH²) of fingertips (N, 2) to goals (2, 2), as (N, 2)."""
    return (-(fingertip[:, None] - goals).square().sum(-1) / WIDTH**2).exp()


class TwoGoals(Environment):
    """Keep the fingertip near two goals at once: a point between them is near neither."""

    model_file = "two_goals.xml"
    substeps = 5  # the control step is 0.05 s

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"left": {"left": 1.0}, "right": {"right": 1.0}}
        episode_length: int = 40
        nconmax: int = 1
        njmax: int = 1

    def goal(self, name: str) -> np.ndarray:
        """Return the position (2,) of a goal in m."""
        return self.physics.model.site(name).pos[:2]

    def initial_qpos(self) -> np.ndarray:  # the fingertip is in the middle between the goals
        return joint_angles((self.goal("left") + self.goal("right")) / 2)

    @cached_property
    def start(self) -> Tensor:
        """Joint angles (2,) in rad at the start of an episode."""
        return torch.as_tensor(self.initial_qpos()).to(self.physics.ctrl)

    @cached_property
    def goals(self) -> Tensor:
        """Positions (2, 2) in m, one row per objective."""
        return torch.as_tensor(np.stack([self.goal("left"), self.goal("right")])).to(self.start)

    def observe(self) -> Tensor:
        return torch.cat([self.physics.qpos, self.physics.qvel], -1)

    def layout(self) -> list[Part]:
        return [*positions(self.physics.model), *velocities(self.physics.model)]

    def apply(self, action: Tensor) -> None:  # targets of the servos, up to 1 rad from the start
        self.physics.ctrl.copy_(self.start + action.clamp(-1, 1))

    def terms(self) -> dict[str, Tensor]:
        near = nearness(self.physics.sensor("fingertip")[:, :2], self.goals)
        return {"left": near[:, 0], "right": near[:, 1]}

    def failed(self) -> Tensor:
        return torch.zeros_like(self.age, dtype=torch.bool)
