"""The spec of a Gymnasium environment that ends its own episodes."""

from dataclasses import replace

from gymnasium.envs.registration import EnvSpec

from ..envs import Worlds


class WithSpec:
    """Adds `max_episode_steps` to the spec that `gymnasium.make` sets.

    The registered spec cannot have it, because Gymnasium would wrap the environment in a second
    time limit.
    """

    worlds: Worlds
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """How to make this environment again; None if Gymnasium did not make it."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = spec and replace(spec, max_episode_steps=self.worlds.episode_length)
