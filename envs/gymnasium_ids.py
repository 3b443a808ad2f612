"""Every task's id in Gymnasium's registry."""

import re

import gymnasium

NAMESPACE = "morlax_torch"


def gymnasium_id(name: str) -> str:
    """The id of the task `name`: "my_robot" is "morlax_torch/MyRobot-v0"."""
    words = re.split(r"[\W_]+", name)
    return f"{NAMESPACE}/{''.join(word[:1].upper() + word[1:] for word in words)}-v0"


def announce(name: str) -> None:
    """Let `gymnasium.make` and `gymnasium.make_vec` find the task `name`.

    Both adapters are named, not imported. They check the order of calls themselves, and
    Gymnasium's passive checker would warn of every reward that is a vector.
    """
    known = gymnasium.registry.get(gymnasium_id(name))
    if known is not None and known.kwargs == {"task": name}:
        return  # this module was loaded anew, and Gymnasium would warn of the same id twice
    gymnasium.register(
        gymnasium_id(name),
        entry_point="morlax_torch.adapters.gymnasium_single:GymnasiumEnv",
        vector_entry_point="morlax_torch.adapters.gymnasium_vector:GymnasiumVectorEnv",
        order_enforce=False,
        disable_env_checker=True,
        kwargs={"task": name},
    )
