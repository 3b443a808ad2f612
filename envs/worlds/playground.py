"""Bridge to MuJoCo Playground: N worlds of any of its tasks, which JAX steps."""

from functools import cache
from typing import Any, ClassVar

import torch
from torch import Tensor

from .foreign import ForeignWorlds, Outcome
from .playground_functions import functions_of
from .playground_tasks import PlaygroundOptions, options_class


@cache
def from_task(name: str) -> type["PlaygroundWorlds"]:
    """Return the class of "playground:TASK", a task of MuJoCo Playground.

    "playground:MODULE:TASK" imports the module first, which registers the task.

    Raises:
        MorlaxError: Playground is missing, or it has no such task.
    """
    members = {"Options": options_class(name), "name": name}
    return type("PlaygroundWorlds", (PlaygroundWorlds,), members)


class PlaygroundWorlds(ForeignWorlds):
    """N worlds of a task of MuJoCo Playground, on MJX; `from_task` makes such classes.

    Policies see the observation, or its group "state"; critics also its group "privileged_state".
    Reward terms are the metrics "reward/NAME" as the task reports them (all metrics of a task
    without such names), then "reward", which is the task's own, and "action_l2", the mean of
    squared actions.
    """

    name: ClassVar[str]
    Options: ClassVar[type[PlaygroundOptions]]
    options: PlaygroundOptions
    simulator = "MuJoCo Playground"

    def _open(self, seed: int) -> None:
        self._task = functions_of(self.name, self.options, self.device)
        self._jax = self._task.jax
        self.observation_size = self._task.observation_size
        self.privileged_size = self._task.privileged_size
        self.action_size = self._task.action_size
        self.reward_terms = self._task.reward_terms

    def _start(self) -> Tensor:
        self._draw()
        self._state = self._starts
        self._used = torch.ones(self.num_worlds, dtype=torch.bool, device=self.device)
        self.age = torch.zeros_like(self._used, dtype=torch.int32)
        if self.auto_reset and self.options.stagger:
            self.age.random_(self.episode_length, generator=self.generator)
        return self._first.clone()  # JAX's memory is constant

    def _restart(self, which: Tensor, seen: Tensor) -> Tensor:
        """Restart worlds at starts that were prepared in advance.

        A reset of one world costs as much as one of all, and in some tasks as much as 200 steps. So
        all worlds get a start in advance, and all get another when one world needs its second.
        """
        if (which & self._used).any():
            self._draw()
        self._state = self._task.replace(self._to_jax(which), self._starts, self._state)
        self._used = self._used | which
        self.age = torch.where(which, 0, self.age)
        return torch.where(which[:, None], self._first, seen)

    def _advance(self, action: Tensor) -> Outcome:
        found = self._task.step(self._state, self._to_jax(action.float().clamp(-1, 1)))
        self._state = found[0]
        final, terms, failed = (torch.from_dlpack(part) for part in found[1:])
        blown_up = ~torch.cat([final, terms, action], 1).isfinite().all(1)
        self.age = self.age + 1
        failed = failed | blown_up
        timed_out = (self.age >= self.episode_length) & ~failed
        seen, over = final, failed | timed_out
        if self.auto_reset and over.any():  # waits for the GPU: most steps copy no whole state
            seen = self._restart(over, final)
        return Outcome(seen, final, terms, failed, timed_out, blown_up)

    def _draw(self) -> None:
        """Draw a start for every world."""
        drawn = torch.randint(2**32, (2,), generator=self.generator, device=self.device)
        low, high = drawn.tolist()
        key = self._jax.random.fold_in(self._jax.random.PRNGKey(low), high)
        # bound to its device as actions are, or `step` would be compiled a second time
        key = self._jax.device_put(key, self._jax.devices()[0])
        self._starts, first = self._task.reset(self.num_worlds, key)
        self._first = torch.from_dlpack(first)
        self._used = torch.zeros(self.num_worlds, dtype=torch.bool, device=self.device)

    def _to_jax(self, tensor: Tensor) -> Any:
        return self._jax.dlpack.from_dlpack(tensor.detach().contiguous())
