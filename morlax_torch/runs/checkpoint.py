"""Checkpoints: one file with everything that training or acting continues from."""

import io
import zipfile
from pathlib import Path
from typing import Any

import torch

from ..algorithms.learner import Learner
from ..envs import MorlaxError, Worlds
from ..files import replacing

FORMAT = 2  # 1, of version 0.1, called the learner "morlax"


def describe(env: Worlds) -> dict[str, Any]:
    """Return what a checkpoint and an environment must agree on."""
    return {
        "objectives": list(env.objectives),
        "observation_size": env.observation_size,
        "action_size": env.action_size,
        "privileged_size": env.privileged_size,
    }


def save(path: Path, learner: Learner, progress: dict[str, float]) -> None:
    """Write the whole state of a learner and the run's counters, atomically."""
    contents = {
        "config": learner.config.model_dump(mode="json"),
        "environment": describe(learner.env),
        "own_networks": learner.agent.own_networks(),
        "progress": progress,
        "learner": learner.state_dict(),
    }
    write(path, contents)


def write(path: Path, contents: dict[str, Any]) -> None:
    """Write a file that `load` reads, atomically."""
    whole = io.BytesIO()  # on a full disk torch.save would fail in its own words
    torch.save({"format": FORMAT, **contents}, whole)
    with replacing(path) as file:
        file.write(whole.getbuffer())


def load(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read a file that `save` or `write` wrote, in this or an earlier version.

    Raises:
        MorlaxError: there is no file, it is damaged or not a checkpoint, or it has a format that
            this version cannot read.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            intact = archive.testzip() is None  # compares checksums, which torch.load does not
        contents = torch.load(path, map_location=device, weights_only=True) if intact else None
    except FileNotFoundError:
        raise MorlaxError(f"there is no checkpoint {path}.") from None
    except Exception:  # zip, pickle and torch each fail in their own way on a damaged file
        intact = False
    if not intact:
        raise MorlaxError(
            f"the checkpoint {path} is damaged or not a checkpoint: use another file of its folder."
        )
    if not isinstance(contents, dict) or "format" not in contents:
        raise MorlaxError(f"{path} is not a checkpoint of morlax_torch.")
    if contents["format"] == 1 and "morlax" in contents:
        contents["learner"] = contents.pop("morlax")
    elif contents["format"] not in (1, FORMAT):
        raise MorlaxError(
            f"the checkpoint {path} has format {contents['format']}, but this version of "
            f"morlax_torch reads formats up to {FORMAT}: use the version that wrote it."
        )
    return contents


def restore(contents: dict[str, Any], path: Path, learner: Learner) -> None:
    """Load a checkpoint's contents into `learner`.

    Raises:
        MorlaxError: it has another task or another size, or holds only policies, or the learner's
            worlds cannot be resumed.
    """
    config, env = learner.config, learner.env
    if not env.resumable:
        raise MorlaxError(
            f"a run in {config.env} cannot be resumed, because the state of its worlds cannot be "
            "saved: start a new run."
        )
    if "learner" not in contents:
        raise MorlaxError(f"{path} holds only policies, so training cannot continue from it.")
    stored_config, stored = contents["config"], contents["environment"]
    if stored_config["env"] != config.env:
        raise MorlaxError(f"{path} is of task {stored_config['env']!r}, not {config.env!r}.")
    for name, value in describe(env).items():
        if stored.get(name, 0) != value:
            raise MorlaxError(f"{path} has {name} {stored.get(name, 0)}, but the task has {value}.")
    network = config.network.model_dump(mode="json")
    if stored_config["worlds"] != config.worlds or stored_config["network"] != network:
        raise MorlaxError(
            f"{path} was made with other sizes (worlds {stored_config['worlds']}, network "
            f"{stored_config['network']}): resume with the config of its own run."
        )
    check_networks(contents.get("own_networks", {}), learner.agent.own_networks(), path)
    learner.load_state_dict(contents["learner"])


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
