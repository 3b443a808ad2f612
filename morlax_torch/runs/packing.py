"""Copy what is needed to use a run into a small folder, to share or to ship."""

from pathlib import Path

from ..envs import MorlaxError
from ..evaluation.front import Front
from ..files import replacing
from .evaluating import evaluate
from .loading import find_run, load, save


def pack(run: str | Path, output: Path, device: str | None = None) -> Front:
    """Write the policies of a run's best checkpoint, their front, config and training curve.

    The folder has the shape of a run, so every command accepts it, but training cannot continue
    from it, because critic and optimizers are missing.

    Args:
        run: a run's folder, or a checkpoint in it.
        output: a new folder.
        device: evaluates the front, see `evaluate`.

    Returns:
        The front, evaluated anew with 512 trade-offs.

    Raises:
        MorlaxError: there is no such run, or `output` exists or cannot be written.
    """
    if output.exists():
        raise MorlaxError(f"{output} exists already: choose another folder.")
    source, policy = find_run(run), load(run)
    front = evaluate(policy, device=device)
    kept = {}
    for name in ("config.yaml", "metrics.csv"):
        try:
            kept[name] = (source / name).read_bytes()
        except OSError as error:
            raise MorlaxError(f"cannot read {source / name}: {error.strerror}.") from None
    try:
        (output / "checkpoints").mkdir(parents=True)
    except OSError as error:
        raise MorlaxError(f"cannot make {output}: {error.strerror}.") from None
    save(policy.cpu(), output / "checkpoints" / "best.pt")
    front.save(output / "front.npz")
    for name, contents in kept.items():
        with replacing(output / name) as file:
            file.write(contents)
    return front
