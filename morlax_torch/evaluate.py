"""Judge a trained run: its front, and the indicators of the front."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from . import cli, envs
from .envs import resolve_device
from .evaluation import Evaluator, Front, Protocol
from .figures import front_figure
from .files import replacing
from .policy import find_checkpoint, load
from .tradeoffs import dirichlet_tradeoffs, evaluation_tradeoffs


def evaluate(
    run: Path,
    tradeoffs: int = 512,
    protocol: Protocol = "latched",
    device: str | None = None,
    backend: str | None = None,
    seed: int = 0,
) -> Front:
    """The front of a run's best checkpoint, or of a checkpoint file."""
    place = resolve_device(device)
    policy = load(run, place)
    m = len(policy.objectives)
    draw = dirichlet_tradeoffs if protocol == "paper" else evaluation_tradeoffs
    env = envs.make(
        policy.config.env,
        tradeoffs,
        place,
        backend,
        seed,
        auto_reset=False,
        **policy.config.task.model_dump(),
    )
    evaluator = Evaluator(policy.agent, env, draw(tradeoffs, m), protocol)
    evaluator.compile()
    return evaluator.evaluate()


def command(arguments: Sequence[str]) -> None:
    def main(
        run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
        tradeoffs: int = 512,
        protocol: Protocol = "latched",
        device: str | None = None,
        backend: str | None = None,
        seed: int = 0,
        output: Path | None = None,
    ) -> None:
        """Run the policies of many trade-offs for an episode each and print the indicators.

        Writes front.npz, front.csv and front.png.

        Args:
            run: A run's folder (its best checkpoint), or a checkpoint file.
            tradeoffs: How many: an even grid for two objectives, else corners and draws.
            protocol: latched: an episode ends where the robot fails. paper: as in the paper's
                tables, on Dirichlet draws (there 1024): failed steps earn nothing, and the
                reward of the reset is added.
            device: cuda, cpu, ... (None: CUDA where there is one).
            backend: warp or mujoco (None: by the device).
            seed: Of what the worlds draw at random.
            output: Where to write (None: the run's folder).
        """
        place = output or find_checkpoint(run).parent
        if output is None and place.name == "checkpoints":
            place = place.parent
        front = evaluate(run, tradeoffs, protocol, device, backend, seed)
        write(front, place, title=str(run))
        cli.console.print(summary(front))
        cli.console.print(f"written: {place}/front.npz, front.csv, front.png")

    tyro.cli(main, args=arguments, prog="python -m morlax_torch.evaluate")


def write(front: Front, folder: Path, title: str) -> None:
    """front.npz, front.csv and front.png."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise envs.MorlaxError(f"cannot make {folder}: {error.strerror}.") from None
    front.save(folder / "front.npz")
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(
        [
            *(f"tradeoff_{name}" for name in front.objectives),
            *(f"return_{name}" for name in front.objectives),
            "length",
            "non_dominated",
        ]
    )
    for row in zip(front.tradeoffs, front.returns, front.lengths, front.non_dominated, strict=True):
        tradeoff, returns, length, best = row
        rows.writerow([*tradeoff.tolist(), *returns.tolist(), int(length), int(best)])
    with replacing(folder / "front.csv") as file:
        file.write(text.getvalue().encode())
    with replacing(folder / "front.png") as file:
        front_figure(front, title).savefig(file, format="png", dpi=150)


def summary(front: Front) -> Table:
    """What the front is worth, for the terminal."""
    table = Table(show_header=False)
    for name, value in front.indicators().items():
        table.add_row(name.replace("_", " "), f"{value:,.6g}")
    for index, name in enumerate(front.objectives):
        returns = front.returns[:, index]
        table.add_row(f"{name} (return)", f"{returns.min():,.1f} to {returns.max():,.1f}")
    table.add_row("episode length", f"{front.lengths.mean():,.1f} steps on average")
    return table


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
