"""Let one thing take the place of another: a kernel where it suits, an attribute for a while."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from importlib import import_module
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def kernel(twin: str, suits: Callable[..., bool]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Let a GPU kernel replace the torch definition that is decorated, where it suits.

    Args:
        twin: "package.module.function", of the same parameters; imported when first used.
        suits: tells from the positional arguments whether the twin runs.
    """
    module, _, name = twin.rpartition(".")

    def replaceable(definition: Callable[P, R]) -> Callable[P, R]:
        @wraps(definition)
        def either(*args: P.args, **kwargs: P.kwargs) -> R:
            run = getattr(import_module(module), name) if suits(*args) else definition
            return run(*args, **kwargs)

        return either

    return replaceable


@contextmanager
def replaced(owner: object, name: str, value: object) -> Iterator[None]:
    """Give a module, class or object another attribute of this name within the block.

    For libraries that have no hook.
    """
    inherited = name not in vars(owner)
    usual = vars(owner).get(name)  # as it stands there: a static method stays one
    setattr(owner, name, value)
    try:
        yield
    finally:
        if inherited:
            delattr(owner, name)
        else:
            setattr(owner, name, usual)
