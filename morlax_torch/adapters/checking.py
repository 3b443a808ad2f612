"""Check what users pass to adapters, and the libraries that adapters need."""

import re
from collections.abc import Iterable, Sequence
from importlib import metadata
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Size, Tensor

from .. import envs
from ..envs import MorlaxError, Worlds
from ..envs.errors import installation, shortened, unknown


def require(name: str, package: str, least: str, extra: str) -> None:
    """Check that a library is installed and recent enough.

    Args:
        name: name of the library in messages.
        package: name of its package on PyPI.
        least: oldest supported version.
        extra: extra of morlax-torch that installs it.

    Raises:
        MorlaxError: the library is missing, or older than `least`.
    """
    install = installation(extra)
    try:
        found = metadata.version(package)
    except metadata.PackageNotFoundError:
        raise MorlaxError(f"{name} is not installed: {install}.") from None
    if _numbers(found) < _numbers(least):
        raise MorlaxError(f"{name} {found} is too old, {least} or later is needed: {install}.")


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", version)[:2]]


class UnknownOption(MorlaxError, TypeError):
    """An unknown option, also in Python's own words for an unexpected keyword argument.

    TorchRL's `GymEnv` first tries an option `frameskip`, and goes on without it after a TypeError
    with these words.
    """


def check_options(task: str, options: Iterable[str]) -> None:
    """Check that a task has these options; their values are not checked.

    Raises:
        UnknownOption: the task has no such option.
        MorlaxError: there is no such task.
    """
    known = envs.get(task).Options.model_fields
    for name in options:
        if name not in known:
            advice = unknown("option", name, known)
            raise UnknownOption(f"{advice} ({task} got an unexpected keyword argument {name!r})")


def checked_actions(actions: Tensor | NDArray, shape: Size, place: torch.device) -> Tensor:
    """Check the type, shape and device of actions; their values are not checked.

    Arrays are converted if the worlds are on the CPU. On a GPU, every step would copy them.

    Args:
        actions: as the user passed them.
        shape: the required shape, (N, A).
        place: the device of the worlds.

    Raises:
        MorlaxError: `actions` is not a tensor, or has another shape or device.
    """
    if isinstance(actions, np.ndarray) and place.type == "cpu":
        try:
            actions = torch.tensor(actions, dtype=torch.float32)
        except TypeError:
            raise MorlaxError(f"actions must be numbers, not {actions.dtype}.") from None
    if not isinstance(actions, Tensor):
        raise MorlaxError(
            f"actions must be a torch tensor on {place}, not {type(actions).__name__}: use "
            "torch.as_tensor(actions, device=envs.device), or wrap the environment in "
            "gymnasium.wrappers.vector.ArrayConversion."
        )
    if actions.shape != shape:
        raise MorlaxError(
            f"actions need the shape {tuple(shape)}, one row per world, but have "
            f"{tuple(actions.shape)}."
        )
    if actions.device != place:
        raise MorlaxError(
            f"actions are on {actions.device}, but the worlds are on {place}: use "
            "actions.to(envs.device)."
        )
    return actions


def one_seed(seeds: Sequence[int], number: int) -> int:
    """Mix the seeds of N worlds into one, because one generator draws for all of them.

    Raises:
        MorlaxError: there are not N seeds, or they are not integers from 0.
    """
    if len(seeds) != number:
        raise MorlaxError(
            f"reset needs one seed, or one for each of the {number} worlds, not {len(seeds)}."
        )
    try:
        return int(np.random.SeedSequence(seeds).generate_state(1, np.uint64)[0])
    except (TypeError, ValueError):
        raise MorlaxError(f"seeds must be integers from 0, not {shortened(seeds)}.") from None


def prepare(
    worlds: Worlds,
    random: np.random.Generator,
    options: dict[str, Any] | None,
    draw: bool,
) -> None:
    """Reject options, and reseed the worlds if `draw`.

    Args:
        worlds: reseeded in place.
        random: the environment's generator, which draws the seed of the worlds.
        options: as passed to `reset`; none are supported.
        draw: whether to reseed.

    Raises:
        MorlaxError: `options` is not empty.
    """
    if options:
        raise MorlaxError(
            f"reset takes no options, but got {', '.join(map(repr, options))}: leave them out."
        )
    if draw:
        worlds.reseed(int(random.integers(2**63)))
