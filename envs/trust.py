"""Which code outside this package may run because a file, such as a checkpoint, names it."""

from .errors import MorlaxError
from .naming import GYMNASIUM, MJLAB, PLAYGROUND, absolute, is_file

_TRUSTED: set[str] = set()


def trust(name: str) -> None:
    """Allow files to name the task `name` in this process."""
    _TRUSTED.add(absolute(name))


def check_trusted(name: str, source: object) -> None:
    """Check that the task `name`, which `source` names, may be imported.

    Built-in tasks, entry points of installed packages and the registered environments of
    Gymnasium, mjlab and Playground always may. FILE.py:CLASS, gymnasium:MODULE:ID,
    mjlab:MODULE:TASK and playground:MODULE:TASK run code that the file's author chose; they may
    once the user has named them to `envs.get` or `envs.make`, or trusts the file.

    Raises:
        MorlaxError: the user has not allowed this code.
    """
    runs_code = is_file(name) or any(
        name.startswith(prefix) and ":" in name.removeprefix(prefix)
        for prefix in (GYMNASIUM, MJLAB, PLAYGROUND)
    )
    if runs_code and absolute(name) not in _TRUSTED:
        raise MorlaxError(
            f"{source} would run the code of {name}: if you trust it, add --trust, or from Python "
            "load(..., trust=True)."
        )
