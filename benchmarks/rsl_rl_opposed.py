"""Train ParetoPPO where most trade-offs oppose one of the objectives, beside plain PPO, on a CPU.

    python benchmarks/rsl_rl_opposed.py rows.csv --features 3 6 16

The half-cheetah runs (objective 1) against six times its saving of energy (objective 2), so that
most trade-offs stand still. A row has the return in objective 1 of the policy that only runs.
"""

import contextlib
import io
from pathlib import Path
from typing import Any

import torch
import tyro
from row_files import write_rows
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch import Tensor

from morlax_torch.commands.terminal import cli
from morlax_torch.envs import make

WORLDS, GRADED, TASK = 512, 16, "cheetah"
SAVING = 6.0  # factor of the second objective
RUN = torch.tensor([1.0, 0.0])  # the trade-off that is graded


class Cheetahs(VecEnv):
    """Our task as worlds of rsl_rl, which pay the reward of RUN."""

    def __init__(self, worlds: int):
        self.worlds = make(TASK, worlds, device="cpu")
        self.num_envs, self.num_actions, self.device = worlds, self.worlds.action_size, "cpu"
        self.max_episode_length, self.cfg = self.worlds.episode_length, {}
        self.episode_length_buf = torch.zeros(worlds, dtype=torch.long)
        self.observation = self.worlds.reset().clone()
        self.rewards = torch.zeros(worlds, 2)

    def get_observations(self) -> TensorDict:
        return TensorDict({"actor": self.observation}, batch_size=[self.num_envs])

    def step(self, actions: Tensor) -> tuple[Any, ...]:
        after = self.worlds.step(actions.clamp(-1, 1))
        self.observation = after.observation.clone()
        self.rewards = after.reward * torch.tensor([1.0, SAVING])
        dones = (after.terminated | after.truncated).long()
        return self.get_observations(), self.rewards @ RUN, dones, {"time_outs": after.truncated}


def terms_of(worlds: Cheetahs) -> dict[str, Tensor]:
    return {"run": worlds.rewards[:, 0], "save": worlds.rewards[:, 1]}


def trained(seed: int, iterations: int, **algorithm: Any) -> Any:
    """Return rsl_rl's algorithm after training."""
    network = {"class_name": "MLPModel", "hidden_dims": [128, 128], "activation": "elu"}
    network["obs_normalization"] = True
    spread = {"class_name": "GaussianDistribution", "init_std": 1.0}
    settings = {
        "seed": seed,
        "num_steps_per_env": 24,
        "save_interval": iterations + 1,
        "obs_groups": {"actor": ["actor"], "critic": ["actor"]},
        "actor": {**network, "distribution_cfg": spread},
        "critic": dict(network),
        "algorithm": {"entropy_coef": 0.01, "max_grad_norm": 1.0, **algorithm},
    }
    torch.manual_seed(seed)
    with contextlib.redirect_stdout(io.StringIO()):
        runner = OnPolicyRunner(Cheetahs(WORLDS), settings, None, "cpu")
        runner.learn(iterations)
    return runner.alg


@torch.no_grad()
def graded(policy: Any) -> float:
    """Return the mean return of RUN."""
    worlds, total = Cheetahs(GRADED), torch.zeros(GRADED)
    policy.eval()
    for _ in range(worlds.max_episode_length):
        total += worlds.step(policy(worlds.get_observations()))[1]
    return float(total.mean())


def main(
    output: tyro.conf.Positional[Path],
    features: tuple[int, ...] = (3, 6, 16),
    seeds: tuple[int, ...] = (100, 101, 102),
    iterations: int = 100,
    tradeoffs: int = 16,
) -> None:
    """Write a row per method and seed.

    Args:
        output: CSV file.
        features: F, of each ParetoPPO.
        seeds: of training.
        iterations: of each training.
        tradeoffs: K.
    """
    torch.set_num_threads(1)
    options = {"terms": f"{__name__}:terms_of", "tradeoffs": tradeoffs, "evaluation_worlds": 0}
    options |= {"class_name": "morlax_torch.rsl_rl:ParetoPPO", "guide": {"run": 0.0}, "warmup": 0}
    rows = []

    def grade(method: str, seed: int, policy: Any) -> None:
        row = {"method": method, "seed": seed, "return_of_running": f"{graded(policy):.0f}"}
        rows.append(row)
        write_rows(output, rows)

    for seed in seeds:
        grade("PPO", seed, trained(seed, iterations, class_name="PPO").actor)
        for F in features:
            family = trained(seed, iterations, features=F, **options).actor
            grade(f"ParetoPPO, F = {F}", seed, family.plain(RUN))


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
