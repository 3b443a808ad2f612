"""Check the options that a user passes to a Gymnasium environment."""

from collections.abc import Iterable

from .. import envs
from ..envs import MorlaxError
from ..envs.errors import unknown


class UnknownOption(MorlaxError, TypeError):
    """An unknown option, also in Python's own words for an unexpected keyword argument.

    TorchRL's `GymEnv` first tries an option `frameskip`, and goes on without it after a TypeError
    with these words.
    """


def check_options(task: str, options: Iterable[str]) -> None:
    """Check that a task has these options; their values are not checked.

    Raises:
        UnknownOption: the task has no such option.
        MorlaxError: there is no such task.
    """
    known = envs.get(task).Options.model_fields
    for name in options:
        if name not in known:
            advice = unknown("option", name, known)
            raise UnknownOption(f"{advice} ({task} got an unexpected keyword argument {name!r})")
