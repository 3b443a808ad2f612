"""An environment of mjlab that draws nothing at random."""

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

import torch

from morlax_torch.envs.bridges.mjlab.worlds import build, load


class Memory:
    """An object of a user's own, which holds tensors in a list."""

    def __init__(self, env: Any):
        self.values = [torch.zeros(env.num_envs, device=env.device)]


class Steps:
    """A reward with a state, as users write it: the control steps of an episode so far, squared."""

    def __init__(self, cfg: Any, env: Any):
        self._steps, self._memory = torch.zeros(env.num_envs, device=env.device), Memory(env)

    def reset(self, env_ids: torch.Tensor) -> None:
        self._steps[env_ids] = self._memory.values[0][env_ids] = 0.0

    def __call__(self, env: Any) -> torch.Tensor:
        self._steps = self._steps + 1
        self._memory.values[0] += 1
        return self._steps * self._memory.values[0]


def calm(
    name: str,
    num_envs: int,
    device: str = "cpu",
    *,
    pushed: bool = False,
    edit: Callable[[Any], None] = lambda cfg: None,
    **changes: Any,
) -> Any:
    """Return an environment of mjlab without noise and without differences between worlds.

    All have one command, or start at the first frame of their motion. Where they are `pushed`, each
    push is the same, every 0.2 s, and so are commands, which are drawn every 0.5 s. `changes` are
    of the config, which `edit` changes too.
    """

    def config() -> Any:
        cfg = load(name)
        cfg.scene.num_envs, cfg.seed, cfg.curriculum = num_envs, 0, {}
        kept = ("reset_base", "reset_robot_joints", *(["push_robot"] if pushed else []))
        cfg.events = {key: cfg.events[key] for key in kept if key in cfg.events}
        if "reset_base" in cfg.events:
            cfg.events["reset_base"].params["pose_range"] = {"z": (0.02, 0.02)}
        if pushed:
            cfg.events["push_robot"].interval_range_s = (0.2, 0.2)
            cfg.events["push_robot"].params["velocity_range"] = {"x": (0.4, 0.4)}
        cfg.observations["actor"].enable_corruption = False
        if motion := cfg.commands.get("motion"):
            motion.pose_range, motion.velocity_range = {}, {}
            motion.sampling_mode, motion.joint_position_range = "start", (0.0, 0.0)
        if twist := cfg.commands.get("twist"):
            twist.resampling_time_range = (0.5, 0.5) if pushed else (1e9, 1e9)
            same = {"lin_vel_x": (0.5, 0.5), "lin_vel_y": (0.2, 0.2), "ang_vel_z": (0.1, 0.1)}
            twist.ranges = replace(twist.ranges, **same)
            for share in ("standing", "heading", "world", "forward"):
                setattr(twist, f"rel_{share}_envs", -1.0)
        cfg.rewards["steps"] = import_module("mjlab.managers").RewardTermCfg(func=Steps, weight=1.0)
        edit(cfg)
        return replace(cfg, **changes)

    load(name)  # imports mjlab, whose warnings are not ours
    env = build(name, config, torch.device(device))
    env.reset()
    return env
