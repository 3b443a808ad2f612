"""Build mjlab's worlds, with their kernels compiled in several processes."""

import contextlib
import io
from collections.abc import Callable
from importlib import import_module
from typing import Any

import torch

from ..physics import compiling

_rehearsed: set[tuple[str, str]] = set()  # tasks and kinds of device


def build(name: str, config: Callable[[], Any], device: torch.device) -> Any:
    """Return mjlab's environment. It draws from torch's global generators.

    Args:
        name: the task, whose kernels are compiled once in a process.
        config: returns mjlab's config, which each environment changes.
        device: where to simulate.
    """
    environment = import_module("mjlab.envs").ManagerBasedRlEnv

    def rehearse() -> None:
        env = environment(config(), device=str(device))
        if device.type == "cpu":  # else it has recorded its steps already
            env.reset()
            env.step(torch.zeros(env.num_envs, env.action_manager.total_action_dim))

    with contextlib.redirect_stdout(io.StringIO()):  # tables of all terms
        if (name, device.type) not in _rehearsed:
            _rehearsed.add((name, device.type))
            compiling.start(rehearse)
            compiling.finish()
        return environment(config(), device=str(device))
