"""Run a list of commands, one at a time on each GPU, within a time limit.

    python benchmarks/jobs.py benchmarks/pending.yaml --seconds 1500 --folder measured

A GPU takes the first job that is not begun and whose time still fits. What a job prints goes to
FOLDER/NAME.log. In commands, $FOLDER is that folder, $JOB the job's name, $PYTHON starts Python
with this package, and $MJLAB_PYTHON also with mjlab; the environment may set both. A job with seeds
is one job for each of them, NAME-SEED, and its command may use $SEED.
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import torch
import tyro
import yaml
from pydantic import BaseModel

from morlax_torch.commands.terminal import cli
from morlax_torch.envs import MorlaxError
from morlax_torch.envs.errors import validated


class Job(BaseModel, extra="forbid"):
    """A command, and how long it takes with everything around it."""

    name: str
    seconds: float
    command: str
    seeds: list[int] = []
    after: list[str] = []
    """Names of jobs that must have ended before, if they are in the list."""

    def each(self) -> Iterator["Job"]:
        """Yield this job, once for each seed."""
        if not self.seeds:
            yield self
        for seed in self.seeds:
            command = f"SEED={seed}; {self.command}"
            yield Job(name=f"{self.name}-{seed}", seconds=self.seconds, command=command)


def main(
    plan: tyro.conf.Positional[Path],
    seconds: float,
    folder: Path = Path("measured"),
    only: tuple[str, ...] = (),
    gpus: int | None = None,
) -> None:
    """Run jobs until none is left or none fits.

    Args:
        plan: YAML file with a list of jobs.
        seconds: Time limit; no job begins that would end later.
        folder: Where logs and results go.
        only: Names of jobs to run, in this order; otherwise all.
        gpus: How many jobs run side by side (None: one per GPU).
    """
    jobs = {job.name: job for job in read(plan)}
    for name in only:
        if name not in jobs:
            raise MorlaxError(f"{plan} has no job {name}, only {', '.join(jobs)}.")
    waiting = [jobs[name] for name in only or jobs]
    running: set[str] = set()
    folder.mkdir(parents=True, exist_ok=True)
    began, lock = time.monotonic(), threading.Lock()

    def tell(text: str) -> None:
        cli.console.print(f"{time.monotonic() - began:6.0f} s  {text}")

    def take() -> Job | None:
        while True:
            with lock:
                left = seconds - (time.monotonic() - began)
                fitting = [job for job in waiting if job.seconds <= left]
                unfinished = {*running, *(job.name for job in waiting)}
                for job in fitting:
                    if unfinished.isdisjoint(job.after):
                        waiting.remove(job)
                        running.add(job.name)
                        return job
                if not fitting or not running:
                    return None
            time.sleep(1.0)  # until another GPU has done what the next job needs

    def work(gpu: int) -> None:
        while job := take():
            tell(f"GPU {gpu}: {job.name} begins")
            with (folder / f"{job.name}.log").open("w") as log:
                shell, own = ["bash", "-c", job.command], environment(gpu, folder, job.name)
                code = subprocess.call(shell, stdout=log, stderr=log, env=own)
            with lock:
                running.remove(job.name)
            tell(f"GPU {gpu}: {job.name} ended with {code}")

    number = gpus or max(torch.cuda.device_count(), 1)
    threads = [threading.Thread(target=work, args=(gpu,)) for gpu in range(number)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    tell(f"left: {', '.join(job.name for job in waiting) or 'nothing'}")


def read(plan: Path) -> list[Job]:
    """Return the jobs of a plan, each with at most one seed."""
    listed = [validated(Job, item) for item in yaml.safe_load(plan.read_text())]
    return [job for each in listed for job in each.each()]


def environment(gpu: int, folder: Path, job: str) -> dict[str, str]:
    defaults = {"PYTHON": sys.executable, "MJLAB_PYTHON": sys.executable}
    own = {"CUDA_VISIBLE_DEVICES": str(gpu), "FOLDER": str(folder), "JOB": job}
    return {**defaults, **os.environ, **own}


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
