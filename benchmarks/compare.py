"""Train the methods of a plan on its tasks, on all GPUs of this machine, into one CSV file.

    python benchmarks/compare.py --plan benchmarks/plans/comparison.yaml --output rows.csv

A plan is a YAML file:

    tasks: [cheetah, hopper]
    seeds: [200, 201, 202]
    seconds: 30                   # of training, for every run
    methods:                      # changes of each task's config
      MORLAX: {}
      HYPER-MORL:
        algorithm: hyper-morl
        tasks: {hopper: {ppo.learning_rate: 1.0e-3}}   # more changes, for one task
    settings:                     # to search: every method is trained with each of these changes
      default: {}
      rate 1e-3: {ppo.learning_rate: 1.0e-3}
    keep: 2                       # so many settings per task and method get all seeds: the best
                                  # ones with the first seed

`settings` and `keep` may be left out. Each GPU trains one run at a time. The rows of a run are
appended when it ends: its evaluations while `training`, and two of its best checkpoint, loaded
anew: `best`, with the task's own starts, and `noised`, with 8 episodes per trade-off from noised
starts. Started again, the command trains the runs that have no rows yet. A run that crashed has a
row with its error.
"""

import gc
import math
import os
import tempfile
import threading
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import torch
import tyro
from pydantic import BaseModel, ConfigDict, PositiveFloat, PositiveInt
from row_files import Row, append_rows, read_rows

from morlax_torch import config_for, load
from morlax_torch.commands.terminal import cli
from morlax_torch.commands.terminal.cli import console
from morlax_torch.configuration.config import Config
from morlax_torch.configuration.files import merged, read_yaml
from morlax_torch.envs.errors import validated, words
from morlax_torch.evaluation.evaluator import make_evaluator
from morlax_torch.evaluation.front import Front
from morlax_torch.networks.policy import Policy
from morlax_torch.runs.loading import evaluate
from morlax_torch.runs.progress import Evaluation
from morlax_torch.train import train

FRESH = 1000  # seed of the episodes that count; no training or choice of a checkpoint sees them
NOISE, EPISODES = 0.005, 8  # of noised starts, and their number per trade-off
INDICATORS = ("expected_utility", "sparsity", "cardinality", "obedience", "fall_rate")
KEY = ("task", "method", "setting", "seed")
COLUMNS = (
    *(*KEY, "card", "evaluation", "env_steps", "train_seconds", "total_seconds"),
    *("hypervolume", *INDICATORS, "error"),
)
ENDING = 25.0  # seconds that a run needs beside its training, once its kernels are compiled


class Job(NamedTuple):
    """A run to train."""

    task: str
    method: str
    setting: str
    seed: int
    seconds: float
    changes: dict[str, Any]  # of the task's config

    def __str__(self) -> str:
        return ", ".join(part for part in self.key if part)

    @property
    def key(self) -> tuple[str, ...]:
        """The values of the columns KEY."""
        return tuple(map(str, self[: len(KEY)]))

    def config(self, device: str | None = None) -> Config:
        """Return the config of the run."""
        limits = {"max_env_steps": None, "max_seconds": self.seconds}
        return config_for(self.task, **limits, **self.changes, seed=self.seed, device=device)


class Plan(BaseModel):
    """Tasks x methods x settings x seeds, each trained for `seconds`."""

    model_config = ConfigDict(extra="forbid")
    tasks: list[str]
    seeds: list[int]
    seconds: PositiveFloat
    methods: dict[str, dict[str, Any]]
    settings: dict[str, dict[str, Any]] = {"": {}}
    keep: PositiveInt | None = None

    def jobs(self, rows: Sequence[Row], device: str | None = None) -> list[Job]:
        """Return all runs that can be planned with these rows, seed by seed.

        Further seeds of a search are planned once all settings have a row with the first one.
        """
        if self.keep is None:
            return [job for seed in self.seeds for job in self._of_seed(seed, device)]
        volumes = volumes_of(rows)
        groups: dict[tuple[str, str], list[Job]] = {}
        for job in (jobs := self._of_seed(self.seeds[0], device)):
            groups.setdefault((job.task, job.method), []).append(job)
        if not all(job.key in volumes for job in jobs):
            return jobs
        for seed in self.seeds[1:]:
            for group in groups.values():
                ranked = sorted(group, key=lambda job: volumes[job.key], reverse=True)
                jobs += [job._replace(seed=seed) for job in ranked[: self.keep]]
        return jobs

    def _of_seed(self, seed: int, device: str | None) -> list[Job]:
        jobs: dict[tuple[str, str], Job] = {}
        for task, setting, method in product(self.tasks, self.settings, self.methods):
            changes = dict(self.methods[method])
            changes = merged(changes, changes.pop("tasks", {}).get(task, {}))
            changes = merged(changes, self.settings[setting])
            job = Job(task, method, setting, seed, self.seconds, changes)
            # a setting may be what the task has anyway
            jobs.setdefault((method, job.config(device).model_dump_json()), job)
        return [*jobs.values()]


def main(
    plan: Path,
    output: Path = Path("rows.csv"),
    minutes: float = math.inf,
    fronts: Path | None = None,
    device: str | None = None,
) -> None:
    """Train the runs that are missing.

    Args:
        plan: YAML file of tasks, methods, seeds and seconds.
        output: CSV file to append to.
        minutes: Start no run that could not end within this time.
        fronts: Folder for the fronts of the best checkpoints.
        device: cuda or cpu (None: all GPUs, or the CPU without any).
    """
    runs = validated(Plan, read_yaml(plan))
    cards = torch.cuda.device_count() if device != "cpu" else 0
    end, lock = time.monotonic() + 60 * minutes, threading.Lock()
    while True:
        jobs = runs.jobs(rows := read_rows(output), device)
        done = {tuple(row[name] for name in KEY) for row in rows}
        missing = deque(job for job in jobs if job.key not in done)
        console.print(f"{len(missing)} of {len(jobs)} runs to train")
        if not missing or time.monotonic() + runs.seconds + ENDING > end:
            return
        threads = [
            threading.Thread(
                target=_train_all, args=(card, missing, end, output, fronts, lock), daemon=True
            )
            for card in (range(cards) if cards else [None])
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def _train_all(
    card: int | None,
    missing: deque[Job],
    end: float,
    output: Path,
    fronts: Path | None,
    lock: threading.Lock,
) -> None:
    """Train missing runs in a process of one GPU, until none is left or the time is over."""
    pool = None
    while missing and time.monotonic() + missing[0].seconds + ENDING <= end:
        try:
            job = missing.popleft()
        except IndexError:  # another thread was faster
            break
        pool = pool or ProcessPoolExecutor(1, get_context("spawn"), _show, (card,))
        start = time.monotonic()
        try:
            rows = pool.submit(measured, job, fronts, "cpu" if card is None else None).result()
        except Exception as error:  # else the run would be tried again without end
            rows = [{"evaluation": "crash", "error": words(error)}]
            pool.shutdown(wait=False)
            pool = None  # a CUDA error leaves its process unusable
        with lock:
            key = dict(zip(KEY, job.key, strict=True))
            append_rows(output, [key | rounded(row) for row in rows], COLUMNS)
        result = rows[-1].get("hypervolume", rows[-1].get("error"))
        console.print(f"{job}: {result}, {time.monotonic() - start:.0f} s")
    if pool:
        pool.shutdown()


def _show(card: int | None) -> None:
    """Let a process see one of the GPUs that this one sees."""
    if card is not None:
        visible = os.environ.get("CUDA_VISIBLE_DEVICES")
        os.environ["CUDA_VISIBLE_DEVICES"] = visible.split(",")[card] if visible else str(card)


def measured(job: Job, fronts: Path | None, device: str | None) -> list[dict[str, Any]]:
    """Train a run and return its rows, without the columns KEY."""
    config, times = job.config(device), dict[str, float]()
    rows, evaluations = list[dict[str, Any]](), list[Evaluation]()
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        train(config, output=run, on_evaluation=evaluations.append)
        for one in evaluations:
            times = {"env_steps": one.env_steps}
            times |= {
                name: round(getattr(one, name), 3) for name in ("train_seconds", "total_seconds")
            }
            rows.append({"evaluation": "training", **times, "hypervolume": one.hypervolume})
        release_memory()
        policy = load(run, config.device)
    results = fronts_that_count(policy)
    for name, front in results.items():
        values = {k: v for k, v in front.indicators().items() if k in INDICATORS}
        rows.append({"evaluation": name, **times, "hypervolume": front.hypervolume, **values})
    if fronts:
        fronts.mkdir(parents=True, exist_ok=True)
        results["best"].save(fronts / f"{job}.npz")
    del policy
    release_memory()
    card = "CPU" if config.device == "cpu" else torch.cuda.get_device_name()
    return [{"card": card, **row} for row in rows]


def fronts_that_count(policy: Policy) -> dict[str, Front]:
    """Evaluate policies in episodes that are not those of training, without and with noise."""
    config = policy.config
    noisy = config.with_task(reset_noise=NOISE)
    evaluator = make_evaluator(policy.agent, noisy, seeds=EPISODES, seed=FRESH)
    evaluator.compile()
    best = evaluate(policy, device=config.device, seed=FRESH)
    return {"best": best, "noised": evaluator.evaluate()}


def volumes_of(rows: Sequence[Row]) -> dict[tuple[str, ...], float]:
    """Return the hypervolume that counts of every run: noised starts, 0 after a crash."""
    return {
        tuple(row[name] for name in KEY): float(row["hypervolume"] or 0.0)
        for row in rows
        if row["evaluation"] in ("noised", "crash")
    }


def rounded(row: dict[str, Any]) -> dict[str, Any]:
    return {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()}


def release_memory() -> None:
    """Free the memory of learners that are no longer referenced: worlds, graphs and networks."""
    gc.collect()  # a learner refers to itself
    if torch.cuda.is_available():
        torch.cuda.empty_cache()


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
