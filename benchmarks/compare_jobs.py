"""The runs of a comparison: methods of a YAML file, times tasks, times seeds."""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from morlax_torch import MorlaxError, config_for
from morlax_torch.configuration.config import Config
from morlax_torch.configuration.files import merged, read_yaml
from morlax_torch.envs.naming import title

OURS = ("env", "seed", "device", "max_seconds")  # options that the command sets
OUTCOME, FRONT = "outcome.yaml", "fresh_front.npz"  # in the folder of a run


class Method(NamedTuple):
    """A method to compare."""

    name: str
    changes: dict[str, Any]  # of a task's config, for `config_for`
    seconds: float | None  # of training; None: `max_env_steps` is among the changes
    reference: bool = False  # whether the other methods are measured against its fronts
    trainer: str | None = None  # a module beside this one, whose `train` it uses
    of_tasks: dict[str, dict[str, Any]] = {}  # more changes, by task


class Job(NamedTuple):
    """A run to train."""

    task: str
    method: Method
    seed: int

    def __str__(self) -> str:
        return f"{self.task}, {self.method.name}, seed {self.seed}"

    def folder(self, output: Path) -> Path:
        """Return the folder of the run."""
        return output / title(self.task) / self.method.name / str(self.seed)

    @property
    def changes(self) -> dict[str, Any]:
        """The changes of the task's config."""
        return merged(self.method.changes, self.method.of_tasks.get(self.task, {}))

    def config(self, device: str) -> Config:
        """Return the config of the run.

        Raises:
            MorlaxError: the method's changes do not fit the task.
        """
        own: dict[str, Any] = {"seed": self.seed, "device": device}
        if self.method.seconds is not None:
            own["max_seconds"] = self.method.seconds
        unlimited = {"max_env_steps": None}  # so that learning rates reach zero when time is over
        try:
            return config_for(self.task, **{**unlimited, **self.changes, **own})
        except MorlaxError as error:
            raise MorlaxError(f"{self}: {error}") from None

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that a complete run must agree with."""
        return {
            "task": self.task,
            "seconds": self.method.seconds,
            "changes": self.changes,
            "trainer": self.method.trainer,
        }


def read_methods(path: Path, seconds: float | None, env_steps: int | None = None) -> list[Method]:
    """Read the methods of a YAML file.

    Args:
        path: the file.
        seconds: training time of methods without their own (None: `env_steps` ends them).
        env_steps: environment steps after which training ends, unless a method changes them.

    Raises:
        MorlaxError: the file cannot be read, a method is not valid, or two are the reference.
    """
    limit = {} if env_steps is None else {"max_env_steps": env_steps}
    methods = [_method(name, values, seconds, limit) for name, values in read_yaml(path).items()]
    if not methods:
        raise MorlaxError(f"{path} has no method: add a line such as MORLAX: {{}}.")
    references = [method.name for method in methods if method.reference]
    if len(references) > 1:
        raise MorlaxError(f"{' and '.join(references)} are the reference: only one method can be.")
    return methods


def _method(name: Any, values: Any, seconds: float | None, limit: dict[str, int]) -> Method:
    if not isinstance(name, str) or "/" in name or name.startswith("."):
        raise MorlaxError(
            f"the method {name!r} cannot name a folder: use a name without / or a dot in front."
        )
    if values is not None and not isinstance(values, dict):
        raise MorlaxError(f"the method {name} must hold changes, such as {{network.type: single}}.")
    changes = {**limit, **(values or {})}
    own, reference = changes.pop("seconds", seconds), changes.pop("reference", False)
    if own is not None and not _is_positive(own):
        raise MorlaxError(f"seconds of the method {name} must be a positive number, not {own!r}.")
    if not isinstance(reference, bool):
        raise MorlaxError(
            f"reference of the method {name} must be true or false, not {reference!r}."
        )
    trainer = changes.pop("trainer", None)
    if trainer is not None and not Path(__file__).with_name(f"{trainer}.py").is_file():
        raise MorlaxError(f"trainer of the method {name} must be a module of this folder.")
    of_tasks = changes.pop("tasks", {})
    if not isinstance(of_tasks, dict) or not all(isinstance(v, dict) for v in of_tasks.values()):
        raise MorlaxError(
            f"tasks of the method {name} must hold changes by task, such as "
            "{hopper: {ppo.clip: 0.1}}."
        )
    taken = [key for part in (changes, *of_tasks.values()) for key in part if key in OURS]
    if taken:
        raise MorlaxError(f"the method {name} cannot change {taken[0]}, which the command sets.")
    own = None if own is None else float(own)
    return Method(name, changes, own, reference, trainer, of_tasks)


def _is_positive(number: Any) -> bool:
    is_number = isinstance(number, int | float) and not isinstance(number, bool)
    return is_number and 0 < number < math.inf


def plan(tasks: Sequence[str], methods: Sequence[Method], seeds: Sequence[int]) -> list[Job]:
    """Return all runs, in the order of tables."""
    every = itertools.product(dict.fromkeys(tasks), methods, dict.fromkeys(seeds))
    return [Job(*one) for one in every]


def shared(items: Sequence[Any], share: str) -> list[Any]:
    """Return the K-th of N shares of items, with `share` as K/N.

    It depends on nothing else, so that processes that start at different times agree.

    Raises:
        MorlaxError: `share` is not K/N, with K from 0 to N - 1.
    """
    first, _, number = share.partition("/")
    if not (first.isdecimal() and number.isdecimal() and int(first) < int(number)):
        raise MorlaxError(f"the share {share!r} must be K/N with K from 0 to N - 1, such as 0/4.")
    return list(items[int(first) :: int(number)])


def is_complete(job: Job, output: Path) -> bool:
    """Return whether a run has ended, by itself or in a crash.

    Raises:
        MorlaxError: it was trained with other settings.
    """
    path = job.folder(output) / OUTCOME
    if not path.is_file():
        return False
    found = read_yaml(path)
    for name, value in job.settings.items():
        if found.get(name) != value:
            raise MorlaxError(
                f"{path.parent} was trained with {name} {found.get(name)}, not {value}: choose "
                "another --output, or remove that folder to train the run again."
            )
    return True
