"""Domain randomization for robots of mjlab that walk: late actions, motors, masses, pushes."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from mjlab.envs.mdp import dr  # pyright: ignore[reportMissingImports]
from mjlab.envs.mdp.actions import (  # pyright: ignore[reportMissingImports]
    JointPositionAction,
    JointPositionActionCfg,
)
from mjlab.managers import EventTermCfg, SceneEntityCfg  # pyright: ignore[reportMissingImports]
from torch import Tensor

LATEST = 0.04  # s, the largest delay of actions
STRENGTH = 0.8, 1.2  # factors on gains and largest torque of each motor
MASS = 0.85, 1.15  # factors on the mass of the base
PUSH = 1.5  # factor on mjlab's pushes


def harden(cfg: Any) -> None:
    """Add the randomization to a config of mjlab."""
    events: dict[str, Any] = {}

    def draw(function: Any, asset: Any, **params: Any) -> None:
        params["asset_cfg"] = asset
        events[function.__name__] = EventTermCfg(mode="startup", func=function, params=params)

    for name, action in cfg.actions.items():
        if type(action) is JointPositionActionCfg:
            cfg.actions[name] = LateActionCfg(**vars(action))
            robot = SceneEntityCfg(action.entity_name)
            draw(dr.pd_gains, robot, kp_range=STRENGTH, kd_range=STRENGTH)
            draw(dr.effort_limits, robot, effort_limit_range=STRENGTH)
    if "base_com" in cfg.events:
        base = cfg.events["base_com"].params["asset_cfg"]
        alphas = [math.log(factor) / 2 for factor in MASS]  # mjlab scales a mass by exp(2 alpha)
        draw(dr.pseudo_inertia, base, alpha_range=alphas)
    cfg.events = events | cfg.events  # base_com moves the center of mass that pseudo_inertia sets
    if "push_robot" in cfg.events:
        ranges = cfg.events["push_robot"].params["velocity_range"]
        ranges |= {axis: (PUSH * low, PUSH * high) for axis, (low, high) in ranges.items()}


@dataclass(kw_only=True)
class LateActionCfg(JointPositionActionCfg):
    def build(self, env: Any) -> "LateAction":
        return LateAction(self, env)


class LateAction(JointPositionAction):
    """Targets of joints that arrive some physics steps late, as many as each episode draws.

    At first, joints hold their default positions. mjlab's own delays move on the CPU, which a
    recorded step cannot do.
    """

    def __init__(self, cfg: Any, env: Any):
        super().__init__(cfg, env)
        self._substeps, self._most = env.cfg.decimation, round(LATEST / env.physics_dt)
        number = 1 + math.ceil(self._most / self._substeps)
        self._offset = torch.zeros_like(self.raw_action) + self._offset
        self._sent = self._offset[:, None].repeat(1, number, 1)  # newest first
        self._lag = torch.zeros(env.num_envs, dtype=torch.long, device=env.device)
        self.reset(slice(None))

    def reset(self, env_ids: Any = None) -> None:
        super().reset(env_ids)
        self._lag[env_ids] = torch.randint_like(self._lag, self._most + 1)[env_ids]
        self._sent[env_ids] = self._offset[env_ids, None]

    def process_actions(self, actions: Tensor) -> None:
        super().process_actions(actions)
        newest = self._processed_actions[:, None]
        self._sent.copy_(torch.cat([newest, self._sent[:, :-1]], 1))
        self._substep = 0

    def apply_actions(self) -> None:
        # how many control steps ago the target was sent
        age = (self._lag - self._substep + self._substeps - 1) // self._substeps
        index = age.clamp(min=0)[:, None, None].expand(-1, 1, self.action_dim)
        self._processed_actions = self._sent.gather(1, index)[:, 0]
        self._substep += 1
        super().apply_actions()
