"""Modules that import what they offer at first use (PEP 562)."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def handed_on(
    module: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the `__getattr__` and `__dir__` of a module.

    Args:
        module: its `__name__`.
        homes: where each name comes from, relative to the module's package; a submodule of the
            same name is meant itself.
    """

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        own = sys.modules[module]
        value = import_module(f".{homes[name]}", own.__package__)
        if homes[name] != name:
            value = getattr(value, name)
        setattr(own, name, value)
        return value

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[module]), *homes})

    return find, listed
