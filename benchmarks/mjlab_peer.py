"""mjlab's own training with rsl_rl, to compare with."""

import contextlib
import importlib
import io
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor

from morlax_torch.envs.worlds.mjlab.config import add_terms

LOUD = 100.0  # an action scale that bounds no action


class Peer(NamedTuple):
    """A policy of rsl_rl in the place of an `Agent` and its `Actors`, for every trade-off."""

    policy: Callable[[dict[str, Tensor]], Tensor]
    parameters: dict[str, Tensor] = {}

    def actors(self, tradeoffs: Tensor) -> Self:
        return self

    def copy_(self, other: Self, rows: slice = slice(None)) -> None:
        pass

    def act(self, observation: Tensor) -> Tensor:
        """Return actions (K, 1, A) of worlds whose action scale is LOUD."""
        return self.policy({"actor": observation[:, 0]})[:, None] / LOUD


def trained(
    task: str,
    weights: dict[str, float],
    file: Path,
    seconds: float,
    worlds: int,
    device: str,
    seed: int,
) -> Peer:
    """Load mjlab's own policy, or train it first for so many seconds."""
    known = file.exists()
    runner = make_runner(task, 16 if known else worlds, device, seed, weights)
    if known:
        runner.load(str(file), map_location=device)
    else:
        start = time.perf_counter()
        while time.perf_counter() - start < seconds:
            with contextlib.redirect_stdout(io.StringIO()):
                runner.learn(1, init_at_random_ep_len=runner.current_learning_iteration == 0)
        file.parent.mkdir(parents=True, exist_ok=True)
        runner.save(str(file))
    return Peer(runner.get_inference_policy(device))


def make_runner(
    task: str,
    worlds: int,
    device: str,
    seed: int = 0,
    weights: dict[str, float] | None = None,
) -> Any:
    """Return mjlab's runner of one of its tasks, as its command `train` builds it.

    It writes no files. `weights` are factors on those of rewards, see mjlab_weightings.yaml.
    """
    with contextlib.redirect_stdout(io.StringIO()):
        importlib.import_module("mjlab.tasks")
        registry = importlib.import_module("mjlab.tasks.registry")
        wrappers = importlib.import_module("mjlab.rl")
        importlib.import_module("mjlab.utils.torch").configure_torch_backends()
        cfg, agent = registry.load_env_cfg(task), registry.load_rl_cfg(task)
        cfg.scene.num_envs, cfg.seed, agent.seed = worlds, seed, seed
        add_terms(cfg)
        for term, factor in (weights or {}).items():
            cfg.rewards[term].weight = factor * (cfg.rewards[term].weight or 1.0)
        agent.logger = "tensorboard"
        torch.manual_seed(seed)
        env = importlib.import_module("mjlab.envs").ManagerBasedRlEnv(cfg, device=device)
        wrapped = wrappers.RslRlVecEnvWrapper(env, clip_actions=agent.clip_actions)
        kind = registry.load_runner_cls(task) or wrappers.MjlabOnPolicyRunner
        return kind(wrapped, asdict(agent), None, device)
