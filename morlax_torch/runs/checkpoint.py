"""Checkpoints: one file with everything that training or acting continues from."""

import hashlib
import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Annotated, Any, Self

import torch
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, NonNegativeInt, model_validator
from torch import Tensor
from torch.utils._pytree import tree_map_only

from .. import envs
from ..algorithms.learner import Learner
from ..configuration.config import Config, load_config
from ..envs import DesignParameter, MorlaxError, Worlds
from ..envs.errors import LONGEST, NotFinite, NotInstalled, line, shortened, validated
from ..envs.worlds.options import STORED, check_objectives
from ..host.files import AnyPath, read, write_file
from .progress import Progress
from .references import check_model, code_of, localized, model_of

FORMAT = 2
RSL_RL = "morlax_torch"  # key of the policies in a checkpoint of rsl_rl
POLICY = ("actor.", "observation_normalizer.")  # beginnings of the names of what policies need
Size = Annotated[int, Field(ge=1, le=2**24)]


class Task(BaseModel):
    """The sizes of a task, which do not depend on its code."""

    objectives: Annotated[tuple[str, ...], AfterValidator(check_objectives)]
    observation_size: Size
    action_size: Size
    privileged_size: int = Field(default=0, ge=0, le=2**24)
    designs: dict[str, DesignParameter] = {}
    model_fingerprint: dict[str, str] = {}  # see `references.model_of`; empty: unknown

    @classmethod
    def of(cls, env: Worlds) -> Self:
        task = cls.model_validate(env, from_attributes=True)
        return task.model_copy(update={"model_fingerprint": model_of(env)})


class Contents(BaseModel):
    """Everything in a checkpoint: of a whole learner, or only of policies."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

    format: int
    config: dict[str, Any]
    environment: Task
    # parameter shapes of user-made networks: network -> parameter -> shape
    own_networks: dict[str, dict[str, list[NonNegativeInt]]] = {}
    progress: Progress = Progress()
    learner: dict[str, Any] | None = None  # its `state_dict`, with the agent's tensors as "agent"
    policy: dict[str, Tensor] | None = None  # instead: the agent's tensors without critics

    @property
    def agent(self) -> dict[str, Tensor]:
        """The agent's tensors by name, without critics if there is no learner."""
        return self.policy or {} if self.learner is None else self.learner["agent"]

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.learner is None) == (self.policy is None):
            raise ValueError("it needs either a learner or policies")
        if not isinstance(self.config.get("env"), str):
            raise ValueError("env must name the task")
        agent = self.policy if self.learner is None else self.learner.get("agent")
        if not isinstance(agent, dict) or not all(isinstance(v, Tensor) for v in agent.values()):
            raise ValueError("a learner needs an agent, which consists of tensors by name")
        check_state(agent, agent, "agent")
        return self


def snapshot(learner: Learner) -> dict[str, Any]:
    """Copy the whole state of a learner to the CPU; all processes of its group must call it.

    Raises NotFinite if a number that they share is not finite, since `load` would refuse it.
    """
    group, state = learner.group, tree_map_only(Tensor, Tensor.cpu, learner.state_dict())
    shared = {name: state[name] for name in state.keys() - set(learner.per_process)}
    try:
        check_state(shared, shared, "learner")
    except ValueError as error:
        raise NotFinite(str(error)) from None
    if group.size > 1:
        _, *state["processes"] = group.gather({name: state[name] for name in learner.per_process})
    return {
        "config": learner.config.model_dump(mode="json"),
        "environment": Task.of(learner.env).model_dump(mode="json"),
        "own_networks": learner.agent.own_networks(),
        "learner": state,
    }


def write(path: AnyPath, contents: dict[str, Any], progress: Progress | None = None) -> None:
    """Write a `snapshot`, or policies, and the run's counters, atomically."""
    counters = {} if progress is None else {"progress": progress.model_dump()}
    data = io.BytesIO()  # on a full disk torch.save would fail in its own words
    torch.save({"format": FORMAT, **contents, **counters}, data)
    write_file(path, data.getbuffer())


def load(path: Path) -> Contents:
    data = io.BytesIO(read(path, "checkpoint"))
    try:
        _check_sums(data)
        values = torch.load(data, map_location="cpu", weights_only=True)
        values = values.get(RSL_RL, values)
        number = None if "actor_state_dict" in values else values["format"]
    except MemoryError:
        raise
    except Exception:  # zip, pickle and torch each fail in their own way on a damaged file
        raise MorlaxError(
            f"the checkpoint {path} is damaged or not a checkpoint: use another file of its "
            "folder. Training goes on from one with --start-from FILE."
        ) from None
    if number is None:
        raise MorlaxError(
            f"{path} is a checkpoint of rsl_rl that is no run: ParetoPPO writes one if its option "
            "task names the task, of Gaussian policies that see one group of observations and "
            "learn their standard deviations."
        )
    if number != FORMAT:
        raise MorlaxError(
            f"the checkpoint {path} has format {shortened(number)}, but this version of "
            f"morlax_torch reads format {FORMAT}: use the version that wrote it."
        )
    return validated(Contents, values, f"the checkpoint {path} is damaged: ")


def _check_sums(data: IO[bytes]) -> None:
    """Compare every checksum, which torch.load does not; raises an error of zipfile's."""
    with zipfile.ZipFile(data) as archive:
        parts = archive.infolist()
        # torch.load would leave the memory of what claims to be a folder as it is
        odd = any(part.external_attr or part.compress_size != part.file_size for part in parts)
        if odd or len(archive.NameToInfo) != len(parts) or archive.testzip():
            raise zipfile.BadZipFile
    data.seek(0)


def read_config(contents: Contents, path: Path) -> Config:
    """Return the config of a checkpoint that was read from `path`, if its code is trusted."""
    values, missing = localized(contents.config, folder_of(path)), ""
    file, _, member = contents.config["env"].rpartition(":")
    if file.endswith(".py") and not os.path.isfile(file):
        missing = f"there is no file {file}, which should define the task {member}"
        if values["env"] == contents.config["env"]:
            raise MorlaxError(
                f"{missing} of {path}: name it where it is now, --env FILE.py:{member}, or from "
                "Python load(..., env=...)."
            )
    try:
        for name in code_of(values):
            envs.check_trusted(name, path)
    except MorlaxError as error:
        raise MorlaxError(f"{missing}, and {error}" if missing else str(error)) from None
    try:
        return load_config(values, STORED)
    except NotInstalled:
        raise
    except MorlaxError as error:
        raise MorlaxError(f"the config in {path} does not fit: {error}") from None


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


def restore(contents: Contents, path: Path, learner: Learner) -> bool:
    """Load a checkpoint's contents into `learner`; returns whether the robot's model changed."""
    if contents.learner is None:
        raise MorlaxError(f"{path} holds only policies, so training cannot continue from it.")
    for name, value in Task.of(learner.env):
        stored = getattr(contents.environment, name)
        if name != "model_fingerprint" and stored != value:
            raise MorlaxError(f"{path} has {name} {stored}, but the task has {value}.")
    changed = check_model(contents.environment.model_fingerprint, model_of(learner.env), path)
    check_networks(contents.own_networks, learner.agent.own_networks(), path)
    current, state = learner.state_dict(), dict(contents.learner)
    try:
        processes = [{}, *state.pop("processes", [])]
        if len(processes) == learner.group.size:
            state |= processes[learner.group.rank]
        else:
            # another number of processes trained, so worlds start anew
            state |= {name: current[name] for name in learner.per_process}
        check_state(state, current)
        learner.load_state_dict(state)
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = line(error)[:LONGEST]
        raise MorlaxError(f"the state in {path} does not fit this learner: {reason}.") from None
    return changed


def check_networks(stored: dict[str, Any], passed: dict[str, Any], path: Path) -> None:
    """Raise MorlaxError unless `Agent.own_networks` equals the stored one."""
    for name in stored.keys() - passed.keys():
        raise MorlaxError(
            f"{path} holds a user-made {name}, which no config describes: continue from Python "
            f"and pass a module like it, {name}=..., as when it was trained."
        )
    for name, parameters in passed.items():
        if parameters != stored.get(name):
            raise MorlaxError(
                f"the {name} passed does not match the one in {path}: its parameters are "
                f"{parameters}, but the stored ones are {stored.get(name, 'of its config')}."
            )


def check_state(stored: object, current: object, name: str = "state") -> None:
    """Raise ValueError unless a stored state has current types and shapes, and finite numbers."""
    if isinstance(current, dict) and isinstance(stored, dict):
        # of keys that only one of both has, the learner knows what it can do without
        for key in current.keys() & stored.keys():
            check_state(stored[key], current[key], f"{name}.{key}")
    elif isinstance(current, list) and isinstance(stored, list) and len(current) == len(stored):
        for index, pair in enumerate(zip(stored, current, strict=True)):
            check_state(*pair, f"{name}.{index}")
    elif isinstance(current, Tensor) and isinstance(stored, Tensor):
        # a generator of another device has a state of another size
        same = stored.shape == current.shape or current.dtype == stored.dtype == torch.uint8
        if not same or stored.is_floating_point() != current.is_floating_point():
            raise ValueError(
                f"{name} is {stored.dtype} {tuple(stored.shape)} instead of "
                f"{current.dtype} {tuple(current.shape)}"
            )
        if stored.is_floating_point() and not stored.isfinite().all():
            raise ValueError(f"{name} is not finite")
    elif type(current) is not type(stored) or isinstance(current, list):
        raise ValueError(f"{name} is {shortened(stored)}")
