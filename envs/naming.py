"""Task names, such as FILE.py:CLASS or a library's, and the code that they may run."""

from importlib import metadata
from pathlib import Path

from .errors import MorlaxError, shortened, user_code

GROUP = "morlax_torch.envs"  # of installed packages' entry points
GYMNASIUM = "gymnasium:"  # before an id of Gymnasium's registry
MJLAB = "mjlab:"  # before a task of mjlab's registry
_TRUSTED: set[str] = set()


def is_file(name: str) -> bool:
    """Return whether `name` is FILE.py:CLASS."""
    return name.rpartition(":")[0].endswith(".py") or name.endswith(".py")


def absolute(name: str) -> str:
    """Return FILE.py:CLASS with an absolute path, so that it works from any folder."""
    file, colon, member = name.rpartition(":")
    if not colon or not is_file(name):
        return name
    with user_code(f"{shortened(file)} is not the path of a file"):
        return f"{Path(file).expanduser().resolve()}:{member}"


def title(name: str) -> str:
    """Return the task's name for folders and pictures: of FILE.py:CLASS only the class."""
    return name.rpartition(":")[2] if is_file(name) else name


def movable(name: str) -> str:
    """Return the task's name without the folder of FILE.py:CLASS, in which it may lie elsewhere."""
    return Path(name).name if is_file(name) else name


def offered() -> set[str]:
    """Return the names of installed packages' entry points, without loading them."""
    return metadata.entry_points(group=GROUP).names


def trust(name: str) -> None:
    """Allow files to name the task `name` in this process."""
    _TRUSTED.add(absolute(name))


def runs_code(name: str) -> bool:
    """Return whether importing the task `name` runs code that its user chose."""
    return is_file(name) or any(
        name.startswith(prefix) and ":" in name.removeprefix(prefix)
        for prefix in (GYMNASIUM, MJLAB)
    )


def check_trusted(name: str, source: object) -> None:
    """Check that the task `name`, which `source` names, may be imported.

    Those that run code that the source's author chose (`runs_code`) may once the user has named
    them to `envs.get` or `envs.make`, or trusts the source.
    """
    if runs_code(name) and absolute(name) not in _TRUSTED:
        raise MorlaxError(
            f"{source} would run the code of {name}: if you trust it, add --trust, or from Python "
            "load(..., trust=True)."
        )
