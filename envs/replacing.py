"""Replace an attribute for a while, where a library has no hook."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def replaced(owner: object, name: str, value: object) -> Iterator[None]:
    """Give a module, class or object another attribute of this name within the block."""
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
