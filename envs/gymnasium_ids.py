"""Task ids in Gymnasium's registry."""

import re

import gymnasium

from .errors import MorlaxError

NAMESPACE = "morlax_torch"


def gymnasium_id(name: str) -> str:
    """Return the Gymnasium id of task `name`: "my_robot" becomes "morlax_torch/MyRobot-v0"."""
    words = re.split(r"[\W_]+", name)
    return f"{NAMESPACE}/{''.join(word[:1].upper() + word[1:] for word in words)}-v0"


def announce(name: str) -> None:
    """Register task `name` for `gymnasium.make` and `gymnasium.make_vec`.

    Adapters are registered by import path, so they are imported only when used. Gymnasium's
    wrappers are disabled: the adapters check the order of calls themselves, and the passive checker
    would warn about every vector reward.

    Raises:
        MorlaxError: another task has the same id.
    """
    known = gymnasium.registry.get(gymnasium_id(name))
    if known is not None:
        if known.kwargs == {"task": name}:
            return  # after a module reload, Gymnasium would warn about a duplicate id
        raise MorlaxError(
            f"the environment {known.kwargs.get('task')!r} is {gymnasium_id(name)} in Gymnasium "
            f"already, and {name!r} would be too: choose another name."
        )
    gymnasium.register(
        gymnasium_id(name),
        entry_point="morlax_torch.adapters.gymnasium_single:GymnasiumEnv",
        vector_entry_point="morlax_torch.adapters.gymnasium_vector:GymnasiumVectorEnv",
        order_enforce=False,
        disable_env_checker=True,
        kwargs={"task": name},
    )
