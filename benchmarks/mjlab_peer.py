"""mjlab's own training with rsl_rl, to compare with."""

import contextlib
import importlib
import io
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch


def runner(task: str, worlds: int, device: str, seed: int = 0, log: Path | None = None) -> Any:
    """Return mjlab's runner of one of its tasks, as its command `train` builds it.

    TensorBoard and checkpoints go to the folder `log` (None: nowhere).
    """
    with contextlib.redirect_stdout(io.StringIO()):
        importlib.import_module("mjlab.tasks")
        registry = importlib.import_module("mjlab.tasks.registry")
        wrappers = importlib.import_module("mjlab.rl")
        importlib.import_module("mjlab.utils.torch").configure_torch_backends()
        cfg, agent = registry.load_env_cfg(task), registry.load_rl_cfg(task)
        cfg.scene.num_envs, cfg.seed, agent.seed = worlds, seed, seed
        agent.logger = "tensorboard"
        torch.manual_seed(seed)
        env = importlib.import_module("mjlab.envs").ManagerBasedRlEnv(cfg, device=device)
        wrapped = wrappers.RslRlVecEnvWrapper(env, clip_actions=agent.clip_actions)
        kind = registry.load_runner_cls(task) or wrappers.MjlabOnPolicyRunner
        return kind(wrapped, asdict(agent), str(log) if log else None, device)
