"""Compare methods: train tasks x methods x seeds, then make tables and figures.

    python benchmarks/compare.py --tasks cheetah hopper --methods methods.yaml --seconds 60

methods.yaml maps the name of a method to changes of the task's config, see compare_methods.yaml.
Every run has a folder, OUTPUT/TASK/METHOD/SEED. Killed and started again, the command trains what
is missing. A run that crashed counts as done: remove its folder to train it again.

Several GPUs take a share of the runs each, with one process per GPU:

    CUDA_VISIBLE_DEVICES=0 python benchmarks/compare.py --share 0/2 &
    CUDA_VISIBLE_DEVICES=1 python benchmarks/compare.py --share 1/2

To measure what several GPUs give, let them train every run together:

    torchrun --standalone --nproc-per-node 4 benchmarks/compare.py --output four

When a run ends, its best checkpoint is loaded and evaluated once more, on other episodes: that is
what counts. Writes OUTPUT/rows.csv, one row per evaluation, OUTPUT/results.md, the tables, and
figures: curves of the hypervolume while training, a performance profile, and interquartile means of
what counts. To make the tables and figures
again from rows.csv alone:

    python benchmarks/compare.py --output comparison --only-report
"""

import importlib
import shutil
from pathlib import Path

import tyro
import yaml
from compare_jobs import FRONT, OUTCOME, Job, is_complete, plan, read_methods, shared
from compare_report import report
from compare_rows import gather, write_rows
from filelock import FileLock, Timeout

from morlax_torch import MorlaxError, load
from morlax_torch.commands.terminal import cli
from morlax_torch.commands.terminal.cli import console
from morlax_torch.envs import resolve_device
from morlax_torch.evaluation.front import Front
from morlax_torch.host.files import write_file
from morlax_torch.host.resources import release_memory
from morlax_torch.host.torchrun import FIRST, SEVERAL
from morlax_torch.runs.loading import evaluate

METHODS = Path(__file__).with_name("compare_methods.yaml")
FRESH = 1000  # seed of the episodes that count; no training or choice of a checkpoint sees them


def main(
    output: Path = Path("comparison"),
    tasks: tuple[str, ...] = ("cheetah", "hopper", "walker", "ant", "humanoid"),
    methods: Path = METHODS,
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4),
    seconds: float = 60.0,
    env_steps: int | None = None,
    share: str = "0/1",
    device: str | None = None,
    only_report: bool = False,
) -> None:
    """Train the runs that are missing, and report all that are complete.

    Args:
        output: Folder of the runs, tables and figures.
        tasks: Tasks to train.
        methods: YAML file of methods.
        seeds: Random seeds, one run of each task and method per seed.
        seconds: Training time per run, in seconds, of methods without their own.
        env_steps: Environment steps per run, instead of seconds.
        share: Train every N-th run from the K-th on, as K/N, with K from 0.
        device: cuda or cpu (None: CUDA if available).
        only_report: Train nothing, and read OUTPUT/rows.csv alone.
    """
    if only_report:
        console.print(report(output))
        return
    place = str(resolve_device(device))
    chosen = read_methods(methods, None if env_steps else seconds, env_steps)
    jobs = plan(tasks, chosen, seeds)
    missing = [job for job in jobs if not is_complete(job, output)]
    for job in missing:
        job.config(place)  # so that a mistake in a method ends the command here
    own = [job for job in shared(jobs, share) if job in missing]
    for number, job in enumerate(own, start=1):
        console.print(f"{number}/{len(own)}: {job}")
        if SEVERAL:  # of one launch, which need no lock against each other
            _train(job, job.folder(output), place)
        else:
            train_once(job, output, place)
    if not FIRST:
        return
    # else a slower process would replace the report of all runs with an older one
    with FileLock(output / ".report.lock"):
        write_rows(gather(jobs, output), output / "rows.csv")
        console.print(report(output))


def train_once(job: Job, output: Path, device: str) -> None:
    """Train a run, unless another process does so or has done so."""
    folder = job.folder(output)
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder.with_name(f".{folder.name}.lock"), timeout=0):
            if not is_complete(job, output):
                _train(job, folder, device)
    except Timeout:
        console.print(f"another process trains {job}")


def _train(job: Job, folder: Path, device: str) -> None:
    """Train a run from its beginning, and write its outcome last."""
    if FIRST and folder.exists():
        shutil.rmtree(folder)
    release_memory()
    error, config = None, job.config(device)
    try:
        trainer = importlib.import_module(job.method.trainer or "morlax_torch.train")
        trainer.train(config, output=folder)
    except MorlaxError as caught:
        if SEVERAL:
            raise  # the other processes may not know of it
        error = str(caught)
        console.print(f"{job} crashed: {error}")
    if not FIRST:
        return
    folder.mkdir(exist_ok=True)
    if (folder / "checkpoints" / "best.pt").is_file():  # a crash may come before it
        fresh_front(folder, config.device).save(folder / FRONT)
    write_file(folder / OUTCOME, yaml.safe_dump({**job.settings, "error": error}, sort_keys=False))


def fresh_front(folder: Path, device: str | None) -> Front:
    """Evaluate the best checkpoint of a run once more."""
    return evaluate(load(folder, device, trust=True), device=device, seed=FRESH)


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
