"""An environment of mjlab that draws nothing at random."""

from typing import Any

import torch

from morlax_torch.envs.worlds import mjlab


def calm(name: str, num_envs: int = 2) -> Any:
    """Return an environment of mjlab without noise, pushes and differences between worlds."""

    def config() -> Any:
        cfg = mjlab.load(name)
        cfg.scene.num_envs, cfg.seed, cfg.auto_reset = num_envs, 0, False
        cfg.events = {key: cfg.events[key] for key in ("reset_base", "reset_robot_joints")}
        cfg.events["reset_base"].params["pose_range"] = {"z": (0.02, 0.02)}
        cfg.observations["actor"].enable_corruption = False
        cfg.commands["twist"].resampling_time_range = (1e9, 1e9)
        return cfg

    mjlab.load(name)  # imports mjlab, whose warnings are not ours
    env = mjlab.build(name, config, torch.device("cpu"))
    env.reset()
    twist = env.command_manager.get_term("twist")
    for attribute in ("is_heading_env", "is_standing_env", "is_world_env", "is_forward_env"):
        getattr(twist, attribute).zero_()
    return env
