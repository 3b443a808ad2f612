"""The interface of a learner, which the training loop drives."""

from typing import Any, Protocol

from ..configuration.config import Config
from ..envs import Worlds
from ..gpu.group import Group
from ..networks.agent import Agent


class Learner(Protocol):
    """Trains an `Agent` in worlds, one `iterate` at a time. `MORLAX` is one."""

    env: Worlds
    config: Config
    group: Group
    """The processes that train together. `state_dict` copies the state of this process."""
    agent: Agent
    iteration: int
    steps_per_iteration: int
    """Environment steps of an iteration, in all processes."""
    env_steps: int
    """Environment steps learned from so far, in all processes."""

    @property
    def per_process(self) -> tuple[str, ...]:
        """Keys of the state that differ between processes."""
        ...

    def compile(self) -> None:
        """Compile kernels and record graphs; the learner's state is unchanged."""
        ...

    def iterate(self, done: float = 0.0) -> None:
        """Run one iteration, of a run of which the share `done` is over, from 0 to 1."""
        ...

    def metrics(self) -> dict[str, float]:
        """Return means over the iterations since the last call. Waits for the GPU.

        "blowups" and "overflow" are always among them. "entropy" and every metric that ends in
        "_loss" must be finite, else training stops.
        """
        ...

    def state_dict(self) -> dict[str, Any]:
        """Copy everything that future iterations depend on; "agent" holds the agent's state."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a state in place, so that recorded graphs stay valid."""
        ...
