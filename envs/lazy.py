"""Modules that import what they offer at first use (PEP 562), or that can be called."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any


def handed_on(
    module: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the `__getattr__` and `__dir__` of a module.

    Args:
        module: its `__name__`.
        homes: where each name comes from, relative to the module's package.
    """

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        own = sys.modules[module]
        value = getattr(import_module(f".{homes[name]}", own.__package__), name)
        setattr(own, name, value)
        return value

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[module]), *homes})

    return find, listed


class _CallableModule(ModuleType):
    def __call__(self, *args: Any, **options: Any) -> Any:
        return getattr(self, self.__name__.rpartition(".")[2])(*args, **options)


def make_callable(module: str) -> None:
    """Let a module be called as the function of its own name.

    `morlax_torch.train(config)` then works whether `morlax_torch.train` was imported or not, which
    replaces the function of that name in the package with the module.
    """
    sys.modules[module].__class__ = _CallableModule
