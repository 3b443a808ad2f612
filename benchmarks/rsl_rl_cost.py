"""Time an iteration of ParetoPPO and of rsl_rl's PPO, in turns, without physics.

    python benchmarks/rsl_rl_cost.py --device cuda:0 --output rows.csv

4,096 worlds of random observations, with the sizes of mjlab's Go1 and its networks and updates, and
its matrix products in TF32. A row also has the size of a checkpoint.
"""

import contextlib
import io
import tempfile
import time
from pathlib import Path
from typing import Any

import torch
import tyro
from row_files import write_rows
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from morlax_torch.commands.terminal import cli

WORLDS, ACTIONS, TERMS = 4096, 12, 3
SIZES = {"actor": 48, "critic": 70}


class RandomWorlds(VecEnv):
    """Worlds that neither move nor end."""

    def __init__(self, device: str):
        self.num_envs, self.num_actions, self.device = WORLDS, ACTIONS, device
        self.max_episode_length, self.cfg = 1000, {}
        self.episode_length_buf = torch.zeros(WORLDS, dtype=torch.long, device=device)
        self.terms = torch.randn(TERMS, WORLDS, device=device)
        self.never = torch.zeros(WORLDS, dtype=torch.long, device=device)
        groups = {name: torch.randn(WORLDS, size, device=device) for name, size in SIZES.items()}
        self.groups = TensorDict(groups, batch_size=[WORLDS])

    def get_observations(self) -> TensorDict:
        return self.groups

    def step(self, actions: torch.Tensor) -> tuple[Any, ...]:
        return self.groups, self.terms.sum(0), self.never, {"log": {}}


def terms_of(env: RandomWorlds) -> dict[str, torch.Tensor]:
    return dict(zip("abc", env.terms, strict=True))


def measured(device: str, iterations: int, **algorithm: Any) -> tuple[float, int]:
    """Return the mean seconds of an iteration, after a first one, and the bytes of a checkpoint."""
    network = {"hidden_dims": [512, 256, 128], "activation": "elu", "obs_normalization": True}
    network["class_name"] = "MLPModel"
    spread = {"class_name": "GaussianDistribution", "init_std": 1.0}
    settings = {
        "num_steps_per_env": 24,
        "save_interval": 1000,
        "obs_groups": {"actor": ["actor"], "critic": ["critic"]},
        "actor": {**network, "distribution_cfg": spread},
        "critic": network,
        "algorithm": {"num_learning_epochs": 5, "num_mini_batches": 4, **algorithm},
    }
    with contextlib.redirect_stdout(io.StringIO()), tempfile.TemporaryDirectory() as folder:
        runner = OnPolicyRunner(RandomWorlds(device), settings, None, device)
        runner.learn(1)
        start = time.perf_counter()
        runner.learn(iterations)  # which reads its losses, so it waits for the GPU
        taken = (time.perf_counter() - start) / iterations
        runner.save(file := f"{folder}/model.pt")
        return taken, Path(file).stat().st_size


def main(output: Path, device: str = "cpu", iterations: int = 3, repeats: int = 2) -> None:
    """Write a row per method and repeat.

    Args:
        output: CSV file.
        device: cpu (one thread) or a GPU, such as cuda:0.
        iterations: to take the mean of.
        repeats: of all methods, in turns.
    """
    torch.set_num_threads(1)
    torch.backends.cuda.matmul.fp32_precision = "tf32"  # as mjlab's command does
    methods: dict[str, dict[str, Any]] = {"PPO": {"class_name": "PPO"}}
    for K in (8, 16, 32, 128):
        pareto = {"class_name": "morlax_torch.rsl_rl:ParetoPPO", "terms": f"{__name__}:terms_of"}
        methods[f"ParetoPPO, K = {K}"] = {**pareto, "tradeoffs": K, "warmup": 0}
    name = "one CPU thread" if device == "cpu" else torch.cuda.get_device_name(device)
    rows = []
    for _ in range(repeats):
        plain = 0.0
        for method, algorithm in methods.items():
            taken, size = measured(device, iterations, **algorithm)
            plain = plain or taken
            row = {"device": name, "method": method, "seconds_per_iteration": f"{taken:.4g}"}
            row |= {"relative": f"{taken / plain:.3g}", "checkpoint_bytes": size}
            rows.append(row)
            write_rows(output, rows)


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
