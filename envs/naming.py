"""The names of tasks: registered ones, FILE.py:CLASS, and those with the prefix of a library."""

from importlib import metadata
from pathlib import Path

from .errors import MorlaxError, shortened

GROUP = "morlax_torch.envs"  # of installed packages' entry points
GYMNASIUM = "gymnasium:"  # before an id of Gymnasium's registry
MJLAB = "mjlab:"  # before a task of mjlab's registry
PLAYGROUND = "playground:"  # before a task of MuJoCo Playground's registry


def is_file(name: str) -> bool:
    """Return whether `name` is FILE.py:CLASS."""
    return name.rpartition(":")[0].endswith(".py") or name.endswith(".py")


def absolute(name: str) -> str:
    """Return FILE.py:CLASS with an absolute path, so that it works from any folder.

    Raises:
        MorlaxError: FILE.py is not a path: it names an unknown user, or links in a circle.
    """
    file, colon, member = name.rpartition(":")
    if not colon or not is_file(name):
        return name
    try:
        return f"{Path(file).expanduser().resolve()}:{member}"
    except (OSError, RuntimeError, ValueError) as error:
        raise MorlaxError(f"{shortened(file)} is not the path of a file: {error}.") from None


def title(name: str) -> str:
    """Return the task's name for folders and pictures: of FILE.py:CLASS only the class."""
    return name.rpartition(":")[2] if is_file(name) else name


def offered() -> set[str]:
    """Return the names of installed packages' entry points, without loading them."""
    return metadata.entry_points(group=GROUP).names
