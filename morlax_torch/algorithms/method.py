"""What all methods share: a trainer, the agent that is evaluated, and a place in the run."""

from typing import Any

from torch import nn

from ..configuration.config import Config
from ..envs import Worlds
from ..gpu.group import ALONE, Group
from .trainer import Draw, Trainer, make_agent


class Method:
    """A `Learner` that iterates a `Trainer`. Subclasses say what is special about them.

    Args:
        env: the worlds.
        config: every number of the run.
        draw: chooses trade-offs, as of `Trainer`.
        in_order: as of `Agent.of`.
        group: as of `MORLAX`.
        networks: actor and critic, as of `MORLAX`.
    """

    def __init__(
        self,
        env: Worlds,
        config: Config,
        draw: Draw | None = None,
        in_order: int = 0,
        group: Group = ALONE,
        **networks: nn.Module | None,
    ):
        self.agent = make_agent(env, config, in_order, **networks)
        self.trainer = trainer = Trainer(env, config, self.agent, draw, group)
        self.env, self.config, self.group = env, config, group
        self.per_process, self.tradeoffs = trainer.per_process, trainer.tradeoffs
        self.rollout, self.explore, self.learn = trainer.rollout, trainer.explore, trainer.learn
        self.iteration = self.env_steps = 0
        self.steps_per_iteration = config.worlds * config.horizon * group.size

    def compile(self) -> None:
        """Compile kernels and record graphs; the learner's state is unchanged."""
        self.trainer.compile()

    def iterate(self, done: float = 0.0) -> None:
        """Run one iteration, of a run of which the share `done` is over, from 0 to 1."""
        self.trainer.iterate(done)
        self.iteration += 1
        self.env_steps += self.steps_per_iteration

    def metrics(self) -> dict[str, float]:
        """Return means over the iterations since the last call; see `Trainer.metrics`."""
        return self.trainer.metrics()

    def state_dict(self) -> dict[str, Any]:
        """Copy everything that future iterations depend on."""
        place = {"iteration": self.iteration, "env_steps": self.env_steps}
        return {**self.trainer.state_dict(), **place}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a state in place, so that recorded graphs stay valid."""
        self.trainer.load_state_dict(state)
        self.iteration = state["iteration"]
        # before several processes could train, every iteration had as many
        self.env_steps = state.get("env_steps", self.iteration * self.steps_per_iteration)
