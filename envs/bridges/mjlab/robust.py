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
STRENGTH = 0.2  # share by which gains and largest torques of each motor differ
MASS = 0.15  # share by which the mass of the base differs
PUSH = 1.5  # times the largest change of velocity by a push of mjlab


def harden(cfg: Any) -> None:
    """Add the randomization to a config of mjlab whose actions are positions of joints."""
    events: dict[str, Any] = {}
    for name, action in cfg.actions.items():
        if type(action) is JointPositionActionCfg:
            cfg.actions[name] = LateActionCfg(**vars(action))
            robot = SceneEntityCfg(action.entity_name)
            events |= {f"{name}_{key}": event for key, event in _motors(robot).items()}
    if "base_com" in cfg.events:
        # first, because it also writes the center of mass, which base_com then moves
        base = cfg.events["base_com"].params["asset_cfg"]
        # mjlab scales a mass by exp(2 alpha)
        alphas = math.log(1 - MASS) / 2, math.log(1 + MASS) / 2
        params = {"asset_cfg": base, "alpha_range": alphas}
        events["base_mass"] = EventTermCfg(mode="startup", func=dr.pseudo_inertia, params=params)
    cfg.events = events | cfg.events
    if "push_robot" in cfg.events:
        ranges = cfg.events["push_robot"].params["velocity_range"]
        for axis, (low, high) in ranges.items():
            ranges[axis] = PUSH * low, PUSH * high


def _motors(robot: Any) -> dict[str, Any]:
    span, one = (1 - STRENGTH, 1 + STRENGTH), {"asset_cfg": robot}
    gains = {"kp_range": span, "kd_range": span}
    return {
        "gains": EventTermCfg(mode="startup", func=dr.pd_gains, params=one | gains),
        "torques": EventTermCfg(
            mode="startup", func=dr.effort_limits, params=one | {"effort_limit_range": span}
        ),
    }


@dataclass(kw_only=True)
class LateActionCfg(JointPositionActionCfg):
    """Config of `LateAction`."""

    def build(self, env: Any) -> "LateAction":
        return LateAction(self, env)


class LateAction(JointPositionAction):
    """Targets of joints that arrive late, by as many physics steps as an episode draws.

    Until the first target arrives, joints hold their default positions. mjlab's own delays move on
    the CPU, which a recorded step cannot do.
    """

    def __init__(self, cfg: Any, env: Any):
        super().__init__(cfg, env)
        self._substeps, self._most = env.cfg.decimation, round(LATEST / env.physics_dt)
        number = 1 + math.ceil(self._most / self._substeps)
        self._lag = torch.zeros(env.num_envs, dtype=torch.long, device=env.device)
        self._sent = torch.zeros_like(self._raw_actions)[:, None].repeat(1, number, 1)
        self._substep = 0
        self.reset(slice(None))

    def reset(self, env_ids: Any = None) -> None:
        super().reset(env_ids)
        self._lag[env_ids] = torch.randint_like(self._lag, self._most + 1)[env_ids]
        start = torch.zeros_like(self._raw_actions) + self._offset
        self._sent[env_ids] = start[env_ids, None]

    def process_actions(self, actions: Tensor) -> None:
        super().process_actions(actions)
        newest = self._processed_actions[:, None]
        self._sent.copy_(torch.cat([newest, self._sent[:, :-1]], 1))
        self._substep = 0

    def apply_actions(self) -> None:
        # of the control steps that the targets before were sent in
        age = (self._lag - self._substep + self._substeps - 1) // self._substeps
        index = age.clamp(min=0)[:, None, None].expand(-1, 1, self.action_dim)
        self._processed_actions = self._sent.gather(1, index)[:, 0]
        self._substep += 1
        super().apply_actions()
