"""The tasks in Gymnasium's registry: their ids and specs."""

import re

import gymnasium

from . import MorlaxError
from .registry import announce_to

NAMESPACE = "morlax_torch"


def announce(name: str) -> None:
    """Register task `name` for `gymnasium.make`: "my_robot" becomes "morlax_torch/MyRobot-v0".

    Adapters are registered by import path, so they are imported only when used. Gymnasium's
    wrappers are disabled: the adapters check the order of calls themselves, and the passive checker
    would warn about every vector reward.
    """
    words = re.split(r"[\W_]+", name)
    identity = f"{NAMESPACE}/{''.join(word[:1].upper() + word[1:] for word in words)}-v0"
    former = gymnasium.registry.get(identity)
    if former is not None:
        if former.kwargs == {"task": name}:
            return  # after a module reload, Gymnasium would warn about a duplicate id
        raise MorlaxError(
            f"the environment {former.kwargs.get('task')!r} is {identity} in Gymnasium already, "
            f"and {name!r} would be too: choose another name."
        )
    gymnasium.register(
        identity,
        entry_point=f"{NAMESPACE}.adapters.gymnasium_single:GymnasiumEnv",
        vector_entry_point=f"{NAMESPACE}.adapters.gymnasium_vector:GymnasiumVectorEnv",
        order_enforce=False,
        disable_env_checker=True,
        kwargs={"task": name},
    )


announce_to(announce)
