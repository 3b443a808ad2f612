"""Evaluate the policies of a run, and pack them with their front."""

from pathlib import Path

from ..configuration.files import write_record
from ..configuration.sections import Protocol
from ..envs import resolve_device
from ..evaluation.evaluator import make_evaluator
from ..evaluation.front import Front
from ..host.files import AnyPath, making, read
from ..networks.policy import Policy
from .checkpoint import fingerprint, front_path
from .hardware import read_machines, write_machines
from .loading import BOOKMARKS, find_checkpoint, find_run, load, load_front, save
from .progress import read_rows
from .references import copy_files


def evaluate(
    run: AnyPath | Policy,
    tradeoffs: int | None = None,
    protocol: Protocol | None = None,
    device: str | None = None,
    backend: str | None = None,
    seed: int = 0,
    seeds: int | None = None,
) -> Front:
    """Evaluate a run's best checkpoint, a checkpoint file, a shipped name, or a policy.

    Args:
        run: the policies; a `Policy` is moved to the device.
        tradeoffs: K, the number of trade-offs: an even grid for two objectives; the corners and
            fixed random draws for more; None: as in training, or the 1,024 random ones of
            published tables.
        protocol: how returns are counted, see `Evaluator`; None: as in training.
        device: "cuda", "cpu", ...; None selects CUDA if there is a GPU.
        backend: "warp" or "mujoco"; None is chosen by device.
        seed: random seed of the worlds, for tasks with random starts or models.
        seeds: episodes per trade-off, each with its own random draws, to average over; None: as in
            training.

    Raises:
        MorlaxError: there is no such run, a number is out of range, nothing in the task is random
            although `seeds` > 1, or the task cannot be evaluated by the protocol.
    """
    target = resolve_device(device)
    policy = (run if isinstance(run, Policy) else load(run, target)).to(target)
    config = policy.config.model_copy(update={"device": str(target), "backend": backend})
    m = len(policy.objectives)
    evaluator = make_evaluator(policy.agent, config, m, protocol, tradeoffs, seeds, seed)
    evaluator.compile()
    mark = fingerprint(policy.agent.state_dict())
    return evaluator.evaluate()._replace(fingerprint=mark)


def front_of(run: str | Path, policy: Policy, device: str | None = None) -> Front:
    """Load the front of a run, or evaluate its `policy` if it has none."""
    path = find_checkpoint(run)
    if front_path(path).is_file():
        return load_front(run)
    return evaluate(policy, device=device)._replace(checkpoint=path.name)


def pack(run: str | Path, output: Path, device: str | None = None) -> Front:
    """Write the policies of a run's best checkpoint, their front, config and training curve.

    The folder, new or empty, gets the shape of a run, so every command accepts it, but training
    cannot continue from it. Returns the front, which `device` evaluates if the run has none.
    """
    source, policy = find_run(run), load(run)
    machines = read_machines(source)
    read_rows(source / "metrics.csv")  # refuses a damaged file
    with making(output) as draft:
        (draft / "checkpoints").mkdir()
        front = front_of(run, policy, device)._replace(checkpoint="best.pt")
        save(policy.cpu(), draft / "checkpoints" / "best.pt")
        front.save(draft / "front.npz")
        copy_files(policy.config, draft)
        for name in ("metrics.csv", BOOKMARKS):
            if (source / name).is_file():
                (draft / name).write_bytes(read(source / name))
        if machines:
            write_machines(draft, machines)
        write_record(policy.config, draft)
    return front
