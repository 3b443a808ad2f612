"""Train CAPQL or GPI-LS of morl-baselines on a task of MO-Gymnasium, to compare with.

    python benchmarks/morl_baselines_peers.py --env mo-gymnasium/hopper-2obj --algorithm capql

Needs the extra morl-baselines. Its own code trains with its own defaults, on the CPU. Policies are
evaluated as `morlax train --env mo-gymnasium/hopper-2obj` does with two objectives: an even grid of
trade-offs, undiscounted returns, hypervolume from the reference point of the task.
"""

import contextlib
import io
import time
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import tyro
from row_files import append_rows

from morlax_torch import envs
from morlax_torch.commands.terminal.cli import console
from morlax_torch.configuration.tradeoffs import even_tradeoffs
from morlax_torch.evaluation.pareto import hypervolume


def main(
    env: str = "mo-gymnasium/hopper-2obj",
    algorithm: Literal["capql", "gpi-ls"] = "capql",
    steps: int = 100_000,
    seed: int = 0,
    tradeoffs: int = 64,
    episodes: int = 2,
    output: Path | None = None,
) -> None:
    """Train one algorithm and evaluate its policies.

    Args:
        env: Task of MO-Gymnasium with two objectives, as `morlax train` names it.
        algorithm: Algorithm of morl-baselines.
        steps: Environment steps of training.
        seed: Random seed.
        tradeoffs: Number of policies to evaluate.
        episodes: Episodes of each.
        output: CSV file to add a row to.
    """
    import mo_gymnasium  # registers the environments
    from morl_baselines.common.evaluation import policy_evaluation_mo

    name = env.replace("mo-gymnasium/", "mo-") + "-v5"
    reference = np.array(envs.make(env, 1, "cpu").reference_point)
    start = time.perf_counter()
    agent = trained(algorithm, name, reference, steps, seed)
    seconds = time.perf_counter() - start
    world = mo_gymnasium.make(name)
    world.reset(seed=seed)
    returns = [
        policy_evaluation_mo(agent, world, w.numpy(), rep=episodes)[2]
        for w in even_tradeoffs(tradeoffs, 2)
    ]
    found = hypervolume(np.array(returns), reference)
    row = {"task": env, "algorithm": algorithm, "seed": seed, "env_steps": steps}
    row |= {"train_seconds": round(seconds, 1), "hypervolume": f"{found:.6g}"}
    console.print(*row.values())
    if output is not None:
        append_rows(output, [row])


def trained(algorithm: str, name: str, reference: np.ndarray, steps: int, seed: int) -> Any:
    """Return an agent of morl-baselines after its training."""
    import mo_gymnasium
    from morl_baselines.multi_policy.capql.capql import CAPQL
    from morl_baselines.multi_policy.gpi_pd.gpi_pd_continuous_action import GPILSContinuousAction

    env: gymnasium.Env = mo_gymnasium.make(name)
    kind = CAPQL if algorithm == "capql" else GPILSContinuousAction
    agent = kind(env, log=False, seed=seed, device="cpu")
    with contextlib.redirect_stdout(io.StringIO()):
        agent.train(steps, eval_env=mo_gymnasium.make(name), ref_point=reference, checkpoints=False)
    return agent


if __name__ == "__main__":
    tyro.cli(main)
