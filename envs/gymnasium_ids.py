"""The tasks in Gymnasium's registry: their ids and specs."""

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import gymnasium
from gymnasium.envs.registration import EnvSpec

from . import MorlaxError
from .registry import announce_to

if TYPE_CHECKING:
    from . import Worlds

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
        entry_point=f"{NAMESPACE}.adapters.gymnasium_single:GymnasiumEnv",
        vector_entry_point=f"{NAMESPACE}.adapters.gymnasium_vector:GymnasiumVectorEnv",
        order_enforce=False,
        disable_env_checker=True,
        kwargs={"task": name},
    )


class WithSpec:
    """Adds `max_episode_steps` to the spec that `gymnasium.make` sets.

    The registered spec cannot have it, because Gymnasium would wrap the environment in a second
    time limit.
    """

    worlds: "Worlds"
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """How to make this environment again; None if Gymnasium did not make it."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = spec and replace(spec, max_episode_steps=self.worlds.episode_length)


announce_to(announce)
