"""Build mjlab's worlds, with their kernels compiled in several processes."""

import contextlib
import io
from collections.abc import Callable
from importlib import import_module
from typing import Any

import torch

from ..physics import compiling

_rehearsed: set[str] = set()


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
        env.reset()
        env.step(torch.zeros(env.num_envs, env.action_manager.total_action_dim))

    with contextlib.redirect_stdout(io.StringIO()):  # tables of all terms
        # on a GPU, torch could stop the process at an index that no kernel has written
        if device.type == "cpu" and name not in _rehearsed:
            _rehearsed.add(name)
            compiling.start(rehearse)
            compiling.finish()
        return environment(config(), device=str(device))
