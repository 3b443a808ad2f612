"""Copy what is needed to use a run into a small folder, to share or to ship."""

import shutil
from pathlib import Path

from ..config_files import write_yaml
from ..envs import MorlaxError
from ..evaluation.front import Front
from ..evaluation.history import read_rows
from ..files import read, replacing
from .evaluating import evaluate
from .hardware import read_machines, write_machines
from .loading import find_run, load, save
from .rewards import copy_reward


def pack(run: str | Path, output: Path, device: str | None = None) -> Front:
    """Write the policies of a run's best checkpoint, their front, config and training curve.

    The folder has the shape of a run, so every command accepts it, but training cannot continue
    from it, because critic and optimizers are missing.

    Args:
        run: a run's folder, or a checkpoint in it.
        output: a new folder.
        device: evaluates the front, see `evaluate`.

    Returns:
        The front, evaluated anew as in training.

    Raises:
        MorlaxError: there is no such run, or `output` exists or cannot be written.
    """
    if output.exists():
        raise MorlaxError(f"{output} exists already: choose another folder.")
    source, policy = find_run(run), load(run)
    metrics = read(source / "metrics.csv", "training curve")
    machines = read_machines(source)
    read_rows(source / "metrics.csv")  # refuses a damaged file
    try:
        (output / "checkpoints").mkdir(parents=True)
    except OSError as error:
        raise MorlaxError(f"cannot make {output}: {error.strerror}.") from None
    try:
        front = evaluate(policy, device=device)
        save(policy.cpu(), output / "checkpoints" / "best.pt")
        front.save(output / "front.npz")
        copy_reward(policy.config, output)
        if machines:
            write_machines(output, machines)
        for name, contents in (
            ("config.yaml", write_yaml(policy.config).encode()),
            ("metrics.csv", metrics),
        ):
            with replacing(output / name) as file:
                file.write(contents)
    except BaseException:
        shutil.rmtree(output, ignore_errors=True)
        raise
    return front
