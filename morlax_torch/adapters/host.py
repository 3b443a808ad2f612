"""Whether a library that one of our interfaces serves is there."""

import re
from importlib import metadata

from ..envs import MorlaxError


def require(name: str, package: str, least: str, extra: str) -> None:
    """Say what to install, where a library is missing or too old.

    Args:
        name: the library's, in prose.
        package: as pip calls it.
        least: the first version that can be served.
        extra: of morlax-torch, that brings it along.

    Raises:
        MorlaxError: it is not installed, or older than `least`.
    """
    install = f"pip install 'morlax-torch[{extra}]'"
    try:
        found = metadata.version(package)
    except metadata.PackageNotFoundError:
        raise MorlaxError(f"{name} is not installed: {install}.") from None
    if _numbers(found) < _numbers(least):
        raise MorlaxError(f"{name} {found} is too old, {least} or later is needed: {install}.")


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", version)[:2]]
