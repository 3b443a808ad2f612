"""Trust in the code that the config of a run names."""

from collections.abc import Iterator
from typing import Any

from .. import envs

NAMES_CODE = ("env", "scalarization")  # fields of a config that may name a file or module


def trust_code(config: dict[str, Any]) -> None:
    """Allow files to name the code of a config, in this process."""
    for name in _names(config):
        envs.trust(name)


def check_code(config: dict[str, Any], source: object) -> None:
    """Raise MorlaxError if the config of the file `source` names code that is not trusted."""
    for name in _names(config):
        envs.check_trusted(name, source)


def _names(config: dict[str, Any]) -> Iterator[str]:
    for field in NAMES_CODE:
        name = config.get(field)
        if isinstance(name, str):  # other values fail when the config is checked
            yield name
