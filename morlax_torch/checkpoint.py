"""One file that holds all that training, or acting, goes on from."""

import io
import zipfile
from pathlib import Path
from typing import Any

import torch

from .envs import MorlaxError, Worlds
from .files import replacing
from .morlax import MORLAX

FORMAT = 1


def describe(env: Worlds) -> dict[str, Any]:
    """What must be equal for a checkpoint to fit an environment."""
    return {
        "objectives": list(env.objectives),
        "observation_size": env.observation_size,
        "action_size": env.action_size,
        "privileged_size": env.privileged_size,
    }


def save(path: Path, morlax: MORLAX, progress: dict[str, float]) -> None:
    """Write the whole state of `morlax` and the run's own counters, atomically."""
    contents = {
        "config": morlax.config.model_dump(mode="json"),
        "environment": describe(morlax.env),
        "own_networks": morlax.agent.own_networks(),
        "progress": progress,
        "morlax": morlax.state_dict(),
    }
    write(path, contents)


def write(path: Path, contents: dict[str, Any]) -> None:
    """A file that `load` reads, atomically."""
    whole = io.BytesIO()
    torch.save(
        {"format": FORMAT, **contents}, whole
    )  # straight to a full disk it would fail in words of its own
    with replacing(path) as file:
        file.write(whole.getbuffer())


def load(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """What `save` or `write` wrote.

    Raises:
        MorlaxError: no file, not a checkpoint, damaged, or of a format this version cannot read.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            intact = archive.testzip() is None  # compares checksums, which torch.load does not
        contents = torch.load(path, map_location=device, weights_only=True) if intact else None
    except FileNotFoundError:
        raise MorlaxError(f"there is no checkpoint {path}.") from None
    except Exception:  # a damaged file trips zip, pickle or torch in many ways
        intact = False
    if not intact:
        raise MorlaxError(
            f"the checkpoint {path} is damaged or is none: use another one of its folder."
        )
    if not isinstance(contents, dict) or "format" not in contents:
        raise MorlaxError(f"{path} is no checkpoint of morlax_torch.")
    if contents["format"] != FORMAT:
        raise MorlaxError(
            f"the checkpoint {path} has format {contents['format']}, but this version of "
            f"morlax_torch reads format {FORMAT}: use the version that wrote it."
        )
    return contents


def restore(contents: dict[str, Any], path: Path, morlax: MORLAX) -> None:
    """Put a loaded checkpoint into `morlax`.

    Raises:
        MorlaxError: it is of another task or another size, or holds policies alone.
    """
    if "morlax" not in contents:
        raise MorlaxError(f"{path} holds policies alone, not what training goes on from.")
    config, env = morlax.config, morlax.env
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
    check_networks(contents.get("own_networks", {}), morlax.agent.own_networks(), path)
    morlax.load_state_dict(contents["morlax"])


def check_networks(stored: dict[str, Any], given: dict[str, Any], path: Path) -> None:
    """Raise MorlaxError unless `Agent.own_networks` says the same now as when it was stored."""
    for name, parameters in stored.items():
        if name not in given:
            raise MorlaxError(
                f"{path} holds a user's own {name}, which no config describes: go on from Python "
                f"and give a module like it, {name}=..., as when it was trained."
            )
        if given[name] != parameters:
            raise MorlaxError(
                f"the {name} given is not like the one in {path}: its parameters are "
                f"{given[name]}, but there they are {parameters}."
            )
    for name in given:
        if name not in stored:
            raise MorlaxError(f"{path} holds the {name} of its config: leave out {name}=...")
