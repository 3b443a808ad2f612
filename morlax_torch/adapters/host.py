"""Check that the library an adapter needs is installed."""

import re
from importlib import metadata

from ..envs import MorlaxError
from ..envs.errors import installation


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
