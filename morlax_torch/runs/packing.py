"""Copy the policies of a run into a small folder, to share or to ship."""

from pathlib import Path

from ..configuration.files import write_yaml
from ..evaluation.front import Front
from ..files import making, read
from .evaluating import evaluate
from .hardware import read_machines, write_machines
from .history import read_rows
from .loading import find_run, load, save
from .references import copy_reward


def pack(run: str | Path, output: Path, device: str | None = None) -> Front:
    """Write the policies of a run's best checkpoint, their front, config and training curve.

    The folder, new or empty, gets the shape of a run, so every command accepts it, but training
    cannot continue from it, because critic and optimizers are missing. Returns the front, evaluated
    anew on `device` as in training.

    Raises:
        MorlaxError: there is no such run, or `output` is in use or cannot be written.
    """
    source, policy = find_run(run), load(run)
    metrics = read(source / "metrics.csv", "training curve")
    machines = read_machines(source)
    read_rows(source / "metrics.csv")  # refuses a damaged file
    with making(output) as draft:
        (draft / "checkpoints").mkdir()
        front = evaluate(policy, device=device)
        save(policy.cpu(), draft / "checkpoints" / "best.pt")
        front._replace(checkpoint="best.pt").save(draft / "front.npz")
        copy_reward(policy.config, draft)
        if machines:
            write_machines(draft, machines)
        (draft / "config.yaml").write_text(write_yaml(policy.config))
        (draft / "metrics.csv").write_bytes(metrics)
    return front
