"""A hopper that trains in a second."""

from typing import Any

from morlax_torch import config_for
from morlax_torch.configuration.config import Config


def tiny(**changes: Any) -> Config:
    """Return a config for two evaluations, with changes named as on the command line."""
    small = {
        "device": "cpu",
        "backend": "mujoco",
        "worlds": 8,
        "horizon": 4,
        "max_env_steps": 64,
        "sampling.clusters": 4,
        "ppo.minibatches": 1,
        "ppo.epochs": 1,
        "network.hidden": (4,),
        "network.features": 2,
        "network.actor": (4,),
        "network.critic": (4,),
        "evaluation.tradeoffs": 4,
        "evaluation.every": 32,
        "task.episode_length": 5,
    }
    return config_for("hopper", **{**small, **changes})
