"""N points that follow goals and save effort: worlds as Isaac Lab and mjlab show them to rsl_rl."""

from types import SimpleNamespace
from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from morlax_torch.envs.bridges.vecenv import from_vecenv

LENGTH, STEP = 20, 0.1
OBJECTIVES = {"tracking": {"track_*": 1.0}, "saving": {"effort": 1.0, "alive": 0.05}}


class Manager:
    """What `ParetoPPO` uses of a reward manager; a term of weight zero is not computed."""

    def __init__(self, env: Any, **terms: tuple[Any, float]):
        self._env = env
        self._terms = {n: SimpleNamespace(func=f, weight=w) for n, (f, w) in terms.items()}
        self.active_terms = [*terms]
        self._step_reward = torch.zeros(env.num_envs, len(terms))

    def get_term_cfg(self, name: str) -> SimpleNamespace:
        return self._terms[name]

    def compute(self) -> Tensor:
        for column, term in enumerate(self._terms.values()):
            self._step_reward[:, column] = term.weight and term.weight * term.func()
        return self._step_reward.sum(1) * self._env.step_dt


class Points(VecEnv):
    """Points (N, 2) that start at zero and are moved by their actions; the goal is (1, 1)."""

    def __init__(self, num_envs: int = 96, device: Any = "cpu"):
        self.num_envs, self.num_actions, self.device = num_envs, 2, device
        self.max_episode_length, self.step_dt, self.cfg = LENGTH, STEP, {}
        self.episode_length_buf = torch.zeros(num_envs, dtype=torch.long)
        self.position, self.action = torch.zeros(num_envs, 2), torch.zeros(num_envs, 2)
        self.reward_manager = Manager(
            self,
            track_x=(lambda: 1 - (self.position[:, 0] - 1).abs(), 1.0),
            track_y=(lambda: 1 - (self.position[:, 1] - 1).abs(), 1.0),
            effort=(lambda: self.action.square().sum(1), -0.5),
            alive=(lambda: torch.ones(num_envs), 0.0),
        )

    @property
    def unwrapped(self) -> "Points":
        return self

    def get_observations(self) -> TensorDict:
        row = torch.arange(self.num_envs)[:, None] / 100
        groups = {"actor": self.position, "critic": torch.cat([self.position, self.action, row], 1)}
        return TensorDict({k: x.clone() for k, x in groups.items()}, batch_size=[self.num_envs])

    def reset(self) -> TensorDict:
        for tensor in (self.position, self.action, self.episode_length_buf):
            tensor.zero_()
        return self.get_observations()

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        self.action = actions.clone()
        self.position = self.position + 0.2 * actions
        self.episode_length_buf = self.episode_length_buf + 1
        reward = self.reward_manager.compute()
        over = self.episode_length_buf >= LENGTH
        self.position = torch.where(over[:, None], 0.0, self.position)
        self.episode_length_buf = torch.where(over, 0, self.episode_length_buf)
        return self.get_observations(), reward, over.long(), {"time_outs": over, "log": {}}


PointsTask = from_vecenv(
    lambda number, device, seed: Points(number, device),
    lambda env, extras: dict(
        zip(env.reward_manager.active_terms, env.reward_manager._step_reward.T * STEP, strict=True)
    ),
    {"tracking": {"track_x": 1.0, "track_y": 1.0}, "saving": {"effort": 1.0}},
    episode_length=LENGTH,
)
