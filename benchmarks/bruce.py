"""Evaluate BRUCE runs by the paper's protocol: returns, command tracking, effect of arm swing.

    python benchmarks/bruce.py runs/bruce/A runs/bruce/B runs/bruce/C --output bruce

Policies for 30,720 trade-offs, drawn from Dirichlet(0.5), walk 500 steps at 0.12 m/s. The reward
at the reset counts; steps after a fall do not. One balanced policy also walks at velocities drawn
from the whole gait library. Writes OUTPUT.md, a table with one column per run, and figures for the
first run: OUTPUT-pairs.png and -commands.png.
"""

from pathlib import Path
from statistics import median
from typing import Annotated, NamedTuple

import numpy as np
import torch
import tyro
from matplotlib.figure import Figure
from row_files import markdown
from torch import Tensor
from walks import Array, Walks, walks

from morlax_torch.commands.terminal.cli import console
from morlax_torch.configuration.tradeoffs import dirichlet_tradeoffs
from morlax_torch.envs import resolve_device
from morlax_torch.envs.robots.bruce.reference import Library
from morlax_torch.evaluation import figures
from morlax_torch.evaluation.front import Front
from morlax_torch.evaluation.style import RUNS, blank
from morlax_torch.networks.policy import Policy
from morlax_torch.runs.loading import load

# The trade-offs of the paper's three policies, in the order of the task's objectives, and two
# trade-offs that differ only in the weights of the arm objectives.
CHOSEN = {
    "arms swing": (0.573, 0.003, 0.323, 0.001, 0.060, 0.041),
    "arms rigid": (0.099, 0.019, 0.099, 0.523, 0.175, 0.085),
    "smoothest": (0.001, 0.007, 0.024, 0.001, 0.967, 0.000),
    "arms swing, other weights equal": (0.3, 0.4, 0.3, 0.0, 0.0, 0.0),
    "arms rigid, other weights equal": (0.3, 0.4, 0.0, 0.3, 0.0, 0.0),
}


def rank_correlations(first: Array, second: Array) -> Array:
    """Return Spearman's rank correlation of each pair of columns of two (P, m) arrays, (m,)."""

    def ranks(values: Array) -> Array:
        order = values.argsort(0).argsort(0)
        return (order - order.mean(0)) / order.std(0)

    return (ranks(first) * ranks(second)).mean(0)


def survival(walks: Walks) -> Array:
    """Return (17, 9) survival rates by the nearest commanded velocity, forward and sideways."""
    library = Library.load()
    cells = [
        np.abs(grid[:, None] - commanded).argmin(0)
        for grid, commanded in zip((library.vx, library.vy), walks.commands.T, strict=True)
    ]
    count, stood = np.zeros((2, len(library.vx), len(library.vy)))
    np.add.at(count, tuple(cells), 1)
    np.add.at(stood, tuple(cells), walks.survived)
    return stood / np.maximum(count, 1)


class Measured(NamedTuple):
    """The results of one run under every protocol."""

    policy: Policy
    tradeoffs: Tensor  # (P, 6)
    spread: Walks  # with `tradeoffs`
    even: Walks  # with trade-offs from Dirichlet(1)
    chosen: Walks  # with CHOSEN, and with equal weights
    commanded: Walks  # with equal weights, at uniformly drawn velocities

    def measures(self) -> dict[str, tuple[float, str]]:
        """Return each measured value and its target, by name."""
        names, returns = self.policy.objectives, self.spread.returns
        most = dict(zip(names, returns.max(0), strict=True))
        joints, swing = (returns[:, names.index(name)] for name in ("joints", "swing"))
        target = {"joints": 990, "base": 1500, "swing": 950, "smooth": 1270, "energy": 950}
        error = np.abs(self.commanded.speed - self.commanded.commands)[self.commanded.survived]
        found = {
            "trade-offs that walk 500 steps, Dirichlet(1)": (self.even.survived.mean(), "0.95"),
            **{f"maximum {name}": (most[name], f"{target.get(name, '')}") for name in names},
            "minimum swing where joints reach 990": (
                swing[joints >= 990].min(initial=np.inf),
                "at most 565",
            ),
            "balanced: m/s forward, commanded 0.12": (self.chosen.speed[-1, 0], "0.10 to 0.14"),
            "balanced: share of 153 velocities survived by most episodes": (
                (survival(self.commanded) > 0.5).mean(),
                "0.9",
            ),
            "balanced: mean error of m/s forward in survived episodes": (error[:, 0].mean(), ""),
        }
        for name, value in zip(
            names, rank_correlations(self.tradeoffs.numpy(), returns), strict=True
        ):
            found[f"rank correlation of weight and return, {name}"] = (value, "")
        for k, name in enumerate(CHOSEN):
            found[f"{name}: m/s forward"] = (self.chosen.speed[k, 0], "")
            found[f"{name}: squared torques, (N m)²"] = (self.chosen.effort[k], "")
        return found


def measure(policy: Policy, number: int, chunk: int) -> Measured:
    """Run every protocol with one policy.

    Args:
        policy: the family of policies to measure.
        number: trade-offs to draw from Dirichlet(0.5).
        chunk: trade-offs to simulate at once.
    """
    m = len(policy.objectives)
    equal = torch.full((1, m), 1 / m)
    draws = np.random.default_rng(0).dirichlet(np.full(m, 0.5), number)
    tradeoffs = torch.from_numpy(draws).float()
    return Measured(
        policy,
        tradeoffs,
        walks(policy, tradeoffs, chunk),
        walks(policy, dirichlet_tradeoffs(1024, m), chunk),
        walks(policy, torch.cat([torch.tensor([*CHOSEN.values()]), equal]), chunk),
        walks(policy, equal.expand(2048, m), chunk, draw_commands=True, standing=0.0),
    )


def commands_figure(measured: Measured) -> Figure:
    """Draw the balanced policy's survival rate by commanded velocity."""
    library, figure = Library.load(), blank(6.4, 3.6, "equal weights for all objectives")
    axes = figure.add_subplot()
    extent = (-0.2125, 0.2125, -0.1125, 0.1125)
    shares = survival(measured.commanded).T
    drawn = axes.imshow(shares, RUNS, vmin=0, vmax=1, origin="lower", extent=extent)
    axes.set_xticks(library.vx[::4])
    axes.set_yticks(library.vy[::2])
    axes.set_xlabel("commanded forward velocity (m/s)")
    axes.set_ylabel("commanded velocity to the left (m/s)")
    figure.colorbar(drawn, label="share of episodes that last 500 steps")
    return figure


def table(found: list[dict[str, tuple[float, str]]]) -> str:
    """Format a Markdown row per quantity; with several runs, add their median and range."""
    several = len(found) > 1
    runs = [f"run {k}" for k in range(len(found))] if several else ["measured"]
    heads = ["", "target", *runs, *(["median (range)"] if several else [])]
    lines = []
    for name, (_, target) in found[0].items():
        values = [run[name][0] for run in found]
        middle = f"{median(values):.3g} ({min(values):.3g} to {max(values):.3g})"
        cells = [f"{value:.4g}" for value in values]
        lines.append([name, target, *cells, *([middle] if several else [])])
    return markdown(heads, lines)


def main(
    runs: Annotated[tuple[str, ...], tyro.conf.Positional],
    tradeoffs: int = 30_720,
    chunk: int = 2048,
    device: str | None = None,
    output: Path = Path("bruce"),
) -> None:
    """Evaluate runs of BRUCE and write a table and figures.

    Args:
        runs: Run folders, checkpoints or names of shipped policies.
        tradeoffs: Number of trade-offs to evaluate.
        chunk: Number of trade-offs to simulate at once.
        device: cuda or cpu (None: CUDA if available).
        output: Path of the output files, without a suffix.
    """
    target = resolve_device(device)
    measured = [measure(load(run, target), tradeoffs, chunk) for run in runs]
    text = table([run.measures() for run in measured])
    console.print(text)
    output.with_suffix(".md").write_text(text)
    first = measured[0]
    front = Front(
        first.policy.objectives,
        first.tradeoffs[::10].numpy(),
        first.spread.returns[::10],
        np.zeros(len(first.tradeoffs[::10])),
        np.zeros(len(first.policy.objectives)),
        np.zeros(len(first.tradeoffs[::10])),
    )
    pictures = {
        "pairs": figures.front_figure(front),
        "commands": commands_figure(first),
    }
    for name, figure in pictures.items():
        figures.save(figure, output.with_name(f"{output.name}-{name}"), ("png",))


if __name__ == "__main__":
    tyro.cli(main)
