"""Checkpoints: one file with everything that training or acting continues from."""

import hashlib
import io
import os
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import torch
from pydantic import ValidationError
from torch import Tensor

from ..algorithms.learner import Learner
from ..configuration.config import Config, load_config
from ..envs import MorlaxError, Worlds
from ..envs import trust as trust_task
from ..envs.errors import LONGEST, explained, shortened
from ..envs.naming import is_file, movable
from ..host.files import (
    AnyPath,
    exists,
    is_folder,
    read,
    write_file,
)
from . import models
from .contents import FORMAT, POLICY, Contents, Task, check_state
from .progress import Progress
from .references import check_code, check_moved, localized, trust_code

RUNS, LATEST = Path("runs"), "latest"


def describe(env: Worlds) -> Task:
    task = Task.model_validate(env, from_attributes=True)
    return task.model_copy(update={"model_fingerprint": models.of_worlds(env)})


def snapshot(learner: Learner) -> dict[str, Any]:
    """Copy the whole state of a learner to the CPU, so that any thread can write it later.

    All processes of the learner's group must call it.
    """
    state, group = _on_cpu(learner.state_dict()), learner.group
    if group.size > 1:
        own = {name: state[name] for name in learner.per_process}
        _, *state["processes"] = group.gather(own)
    return {
        "config": learner.config.model_dump(mode="json"),
        "environment": describe(learner.env).model_dump(mode="json"),
        "own_networks": learner.agent.own_networks(),
        "learner": state,
    }


def save(path: Path, learner: Learner, progress: Progress) -> None:
    """Write the whole state of a learner and the run's counters, atomically."""
    write_snapshot(path, snapshot(learner), progress)


def write_snapshot(path: Path, contents: dict[str, Any], progress: Progress) -> None:
    """Write a `snapshot` and the run's counters, atomically."""
    write(path, {**contents, "progress": progress.model_dump()})


def _on_cpu(state: Any) -> Any:
    if isinstance(state, Tensor):
        return state.cpu()
    if isinstance(state, dict):
        return {name: _on_cpu(value) for name, value in state.items()}
    if isinstance(state, list | tuple):
        return type(state)(map(_on_cpu, state))
    return state


def write(path: AnyPath, contents: dict[str, Any]) -> None:
    """Write a file that `load` reads, atomically."""
    whole = io.BytesIO()  # on a full disk torch.save would fail in its own words
    torch.save({"format": FORMAT, **contents}, whole)
    write_file(path, whole.getbuffer())


def load(path: Path) -> Contents:
    """Read a file that `save` or `write` wrote, to the CPU.

    Raises:
        MorlaxError: there is no file, it is damaged or not a checkpoint, or it has another format.
    """
    whole = io.BytesIO(read(path, "checkpoint"))
    try:
        _check_sums(whole)
        values = torch.load(whole, map_location="cpu", weights_only=True)
    except MemoryError:
        raise
    except Exception:  # zip, pickle and torch each fail in their own way on a damaged file
        raise MorlaxError(
            f"the checkpoint {path} is damaged or not a checkpoint: use another file of its folder."
        ) from None
    if not isinstance(values, dict) or "format" not in values:
        raise MorlaxError(f"{path} is not a checkpoint of morlax_torch.")
    number = values["format"]
    if not isinstance(number, int) or number != FORMAT:
        raise MorlaxError(
            f"the checkpoint {path} has format {shortened(number)}, but this version of "
            f"morlax_torch reads format {FORMAT}: use the version that wrote it."
        )
    try:
        return Contents.model_validate(values)
    except ValidationError as error:
        raise MorlaxError(
            f"the checkpoint {path} is damaged: {explained(error, Contents)}"
        ) from None


def _check_sums(whole: IO[bytes]) -> None:
    """Compare every checksum, which torch.load does not; raises an error of zipfile's."""
    with zipfile.ZipFile(whole) as archive:
        for part in archive.infolist():  # testzip reads by name, and so one of two that are alike
            with archive.open(part) as content:
                while content.read(2**20):
                    pass
            if part.compress_size != part.file_size or part.external_attr:
                # torch.load would leave the memory of what claims to be a folder as it is
                raise zipfile.BadZipFile("torch.save writes neither compressed parts nor folders")
        if len(archive.NameToInfo) != len(archive.filelist):
            raise zipfile.BadZipFile("two parts have the same name")
    whole.seek(0)


def read_config(
    contents: Contents, path: Path, trust: bool = False, env: str | None = None
) -> Config:
    """Return the config of a checkpoint that was read from `path`; `trust` allows its code.

    `env`: where the user says that the task's FILE.py:CLASS is.

    Raises:
        MorlaxError: a value is wrong, the task has moved, or the config names code that is not
            trusted.
    """
    if env is not None:
        check_moved(contents.config["env"], env, path)
        trust_task(env)
    values = localized(contents.config, folder_of(path), env)
    if trust:
        trust_code(values)
    _check_code(values, contents.config["env"], path)
    try:
        return load_config(values)
    except MorlaxError as error:
        raise MorlaxError(f"the config in {path} does not fit: {error}") from None


def _check_code(values: dict[str, Any], task: str, path: Path) -> None:
    """Check that a config's code is there and trusted; the checkpoint at `path` names `task`."""
    file, colon, member = task.rpartition(":")
    missing = ""
    if is_file(task) and colon and not os.path.isfile(file):
        missing = f"there is no file {file}, which should define the task {member}"
    if missing and values["env"] == task:
        raise MorlaxError(
            f"{missing} of {path}: name it where it is now, --env FILE.py:{member}, or from Python "
            "load(..., env=...)."
        )
    try:
        check_code(values, path)
    except MorlaxError as error:
        raise MorlaxError(f"{missing}, and {error}" if missing else str(error)) from None


def newest_runs(folder: Path) -> list[Path]:
    """Return the runs in `folder` or one level deeper that have a checkpoint, the newest first."""
    times: dict[Path, float] = {}
    for depth in ("*", "*/*"):
        for file in folder.glob(f"{depth}/checkpoints/*.pt"):
            with suppress(OSError):  # deleted meanwhile, or not readable
                run, time = file.parent.parent, file.stat().st_mtime
                times[run] = max(times.get(run, 0.0), time)
    return sorted(times, key=times.__getitem__, reverse=True)


def named_run(run: AnyPath) -> Path:
    """Return the path that a user means: the newest run of a folder of runs, or of "latest"."""
    path = Path(run)
    if str(run) == LATEST and not exists(path):
        path = RUNS
    elif not is_folder(path) or any(exists(path / name) for name in ("checkpoints", "config.yaml")):
        return path
    newest = newest_runs(path)
    if not newest and str(run) == LATEST:
        raise MorlaxError(f"there is no run in {RUNS}/ yet: train one first.")
    return newest[0] if newest else path


def folder_of(path: Path) -> Path:
    return path.parent.parent if path.parent.name == "checkpoints" else path.parent


def front_path(path: Path) -> Path:
    """Return the file of a checkpoint's front: the run's front.npz if it is best.pt, NAME.npz."""
    if path.name == "best.pt" and path.parent.name == "checkpoints":
        return folder_of(path) / "front.npz"
    return path.with_suffix(".npz")


def fingerprint(agent: Mapping[str, Tensor]) -> str:
    """Return a short text of the agent's tensors, equal only if policies are equal bit for bit."""
    digest = hashlib.sha256()
    for name in sorted(agent):
        if name.startswith(POLICY):
            values = agent[name].detach().cpu()
            digest.update(f"{name} {values.dtype} {tuple(values.shape)} ".encode())
            digest.update(values.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()[:16]


def restore(contents: Contents, path: Path, learner: Learner) -> None:
    """Load a checkpoint's contents into `learner`.

    Worlds that are not resumable start anew, and so do all if another number of processes trained.

    Raises:
        MorlaxError: it has another task or another size, or holds only policies.
    """
    config, env = learner.config, learner.env
    if contents.learner is None:
        raise MorlaxError(f"{path} holds only policies, so training cannot continue from it.")
    task = contents.config["env"]
    if movable(task) != movable(config.env):
        raise MorlaxError(f"{path} is of task {task!r}, not {config.env!r}.")
    for name, value in describe(env):
        found = getattr(contents.environment, name)
        if name == "model_fingerprint":
            models.warn(models.difference(found, value), path)
        elif found != value:
            raise MorlaxError(f"{path} has {name} {found}, but the task has {value}.")
    stored = read_config(contents, path, env=config.env if is_file(config.env) else None)
    if (stored.worlds, stored.network) != (config.worlds, config.network):
        raise MorlaxError(
            f"{path} was made with other sizes (worlds {stored.worlds}, network "
            f"{stored.network}): resume with the config of its own run."
        )
    check_networks(contents.own_networks, learner.agent.own_networks(), path)
    mine, state = learner.state_dict(), dict(contents.learner)
    try:
        processes = [{}, *state.pop("processes", [])]
        if len(processes) == learner.group.size:
            state |= processes[learner.group.rank]
        else:
            state |= {name: mine[name] for name in learner.per_process}
        check_state(state, mine)
        learner.load_state_dict(state)
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise MorlaxError(
            f"the state in {path} does not fit this learner: {reason[:LONGEST]}."
        ) from None


def check_networks(stored: dict[str, Any], given: dict[str, Any], path: Path) -> None:
    """Raise MorlaxError unless `Agent.own_networks` equals the stored one."""
    for name, parameters in stored.items():
        if name not in given:
            raise MorlaxError(
                f"{path} holds a user-made {name}, which no config describes: continue from Python "
                f"and pass a module like it, {name}=..., as when it was trained."
            )
        if given[name] != parameters:
            raise MorlaxError(
                f"the {name} passed does not match the one in {path}: its parameters are "
                f"{given[name]}, but the stored ones are {parameters}."
            )
    for name in given:
        if name not in stored:
            raise MorlaxError(f"{path} holds the {name} of its config: leave out {name}=...")
