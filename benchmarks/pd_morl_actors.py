"""Replay the actors that PD-MORL's authors published, in our ports of PG-MORL's tasks.

If our ports agree with their environments, the actors reach the paper's hypervolumes here.
benchmarks/notes/tables.md says where to get them.

One episode per trade-off of a grid of 1,001, as in their evaluation, `--episodes` times; with the
noise of their starts, except that velocities are drawn from a normal distribution everywhere.
Prints a CSV table: hypervolume and the best return of each objective.
"""

import argparse
from pathlib import Path

import torch
from torch import Tensor

from morlax_torch import envs
from morlax_torch.evaluation import pareto

TASKS = {  # authors' name, noise of their starts, and the hypervolume that the paper gives
    "walker2d": ("Walker2d", 0.005, 5.41e6),
    "halfcheetah": ("HalfCheetah", 0.1, 5.89e6),
    "ant": ("Ant", 0.1, 7.48e6),
    "swimmer": ("Swimmer", 0.1, 3.21e4),
    "hopper": ("Hopper", 0.005, 1.88e7),
}
GRID = 1001  # trade-offs


def actor(file: Path) -> torch.nn.Sequential:
    """Load an actor: of observation and trade-off, with actions from -1 to 1."""
    weights = torch.load(file, map_location="cpu", weights_only=True)
    layers: list[torch.nn.Module] = []
    for name in ("affine_in", "affine_hid.0", "affine_out"):
        weight = weights[f"{name}.weight"]
        layer = torch.nn.Linear(weight.shape[1], weight.shape[0])
        layer.load_state_dict({part: weights[f"{name}.{part}"] for part in ("weight", "bias")})
        layers += [layer, torch.nn.ReLU()]
    return torch.nn.Sequential(*layers[:-1], torch.nn.Tanh())


@torch.no_grad()
def returns(task: str, act: torch.nn.Module, tradeoffs: Tensor, seed: int, noise: float) -> Tensor:
    """Return the sums of rewards (P, 2) of one episode for each of `tradeoffs` (P, 2)."""
    worlds = len(tradeoffs)
    env = envs.make(task, worlds, "cpu", "mujoco", seed, auto_reset=False, reset_noise=noise)
    seen, total = env.reset(), torch.zeros_like(tradeoffs)
    alive = torch.ones_like(tradeoffs[:, :1])
    for _ in range(env.episode_length):
        step = env.step(act(torch.cat([seen, tradeoffs], -1)))
        total += step.reward * alive
        alive *= ~step.terminated[:, None]
        seen = step.observation
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="EvaluationNetworks of the authors' code")
    parser.add_argument("--episodes", type=int, default=3)
    arguments = parser.parse_args()
    if not arguments.folder.is_dir():
        parser.error(f"there is no folder {arguments.folder}.")
    share = torch.linspace(0, 1, GRID)
    tradeoffs = torch.stack([share, 1 - share], -1)
    print("task,paper,seed,hypervolume,best_0,best_1")
    for task, (name, noise, published) in TASKS.items():
        folder = arguments.folder / f"MO-{name}-v2"
        act = actor(folder / f"MO-{name}-v2_MO_TD3_HER_actor.pkl")
        for seed in range(arguments.episodes):
            reached = returns(f"pgmorl/{task}", act, tradeoffs, seed, noise)
            volume, best = pareto.hypervolume(reached.numpy(), [0.0, 0.0]), reached.amax(0)
            row = f"{task},{published:.0f},{seed},{volume:.0f},{best[0]:.0f},{best[1]:.0f}"
            print(row, flush=True)


if __name__ == "__main__":
    main()
