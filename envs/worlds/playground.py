"""Bridge to MuJoCo Playground: N worlds of any of its tasks, which JAX steps."""

from functools import cache
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from ..errors import MorlaxError
from .interface import TimeStep, Worlds
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


class PlaygroundWorlds(Worlds):
    """N worlds of a task of MuJoCo Playground, on MJX; `from_task` makes such classes.

    Policies see the observation, or its group "state"; critics also its group "privileged_state".
    Reward terms are the metrics "reward/NAME" as the task reports them (all metrics of a task
    without such names), then "reward", which is the task's own, and "action_l2", the mean of
    squared actions.

    Without automatic reset, a world whose episode is over earns nothing and shows how it ended. A
    world that is not finite terminates with zero reward. The state of these worlds is not saved, so
    they start anew when a run is resumed.
    """

    name: ClassVar[str]
    Options: ClassVar[type[PlaygroundOptions]]
    options: PlaygroundOptions
    simulator = "MuJoCo Playground"

    def __init__(
        self,
        options: PlaygroundOptions,
        num_worlds: int,
        device: torch.device,
        seed: int = 0,
        auto_reset: bool = True,
    ):
        self.options, self.num_worlds, self.device = options, num_worlds, device
        self.auto_reset, self.episode_length = auto_reset, options.episode_length
        self.generator = torch.Generator(device).manual_seed(seed)
        self._task = functions_of(self.name, options, device)
        self._jax = self._task.jax
        self.observation_size = self._task.observation_size
        self.privileged_size = self._task.privileged_size
        self.action_size = self._task.action_size
        self.reward_terms = self._task.reward_terms
        self.define_objectives()
        self.blowups = torch.zeros((), dtype=torch.int64, device=device)
        self.reset()

    @classmethod
    def build(
        cls,
        options: Any,
        num_worlds: int,
        device: torch.device,
        backend: str | None,
        seed: int,
        *,
        auto_reset: bool,
        deterministic: bool,
    ) -> Self:
        if backend is not None or deterministic:
            wish = "--deterministic" if deterministic else f"--backend {backend}"
            raise MorlaxError(f"{cls.name} runs on Playground's own simulator: leave {wish} out.")
        return cls(options, num_worlds, device, seed, auto_reset)

    def reset(self) -> Tensor:
        self._draw()
        self._state, self._seen = self._starts, self._first.clone()  # JAX's memory is constant
        self._used = torch.ones(self.num_worlds, dtype=torch.bool, device=self.device)
        self._failed, self._timed_out = torch.zeros_like(self._used), torch.zeros_like(self._used)
        self.age = torch.zeros_like(self._used, dtype=torch.int32)
        if self.auto_reset and self.options.stagger:
            self.age.random_(self.episode_length, generator=self.generator)
        return self._policy(self._seen)

    def restart(self, which: Tensor) -> Tensor:
        self.check_mask(which)
        self._restart(which)
        return self._policy(self._seen)

    def step(self, action: Tensor) -> TimeStep:
        standing = self._failed | self._timed_out
        found = self._task.step(self._state, self._to_jax(action.float().clamp(-1, 1)))
        self._state = found[0]
        seen, paid, failed = (torch.from_dlpack(part) for part in found[1:])
        blown_up = ~torch.cat([seen, paid, action], 1).isfinite().all(1) & ~standing
        self.age = self.age + 1
        failed = failed | blown_up
        timed_out = (self.age >= self.episode_length) & ~failed
        final = torch.where(blown_up[:, None], 0.0, seen)
        paid = torch.where((standing | blown_up)[:, None], 0.0, paid)
        if self.auto_reset:
            self._seen = final
            over = failed | timed_out
            if over.any():  # waits for the GPU, to spare most steps the copy of a whole state
                self._restart(over)
        else:
            final = torch.where(standing[:, None], self._seen, final)
            failed = torch.where(standing, self._failed, failed)
            timed_out = torch.where(standing, self._timed_out, timed_out)
            self._seen, self._failed, self._timed_out = final, failed, timed_out
        self.blowups += blown_up.sum()
        return TimeStep(
            observation=self._policy(self._seen),
            reward=self._combine(paid),
            terminated=failed,
            truncated=timed_out,
            final_observation=self._policy(final),
            terms=dict(zip(self.reward_terms, paid.unbind(1), strict=True)),
            critic_observation=self._seen,
            final_critic_observation=final,
            blown_up=blown_up,
        )

    def critic_observation(self) -> Tensor:
        return self._seen.clone()

    def _restart(self, which: Tensor) -> None:
        """Let worlds begin where the next start is prepared for them.

        A reset of one world costs as much as one of all, and in some tasks as much as 200 steps. So
        all worlds get a start in advance, and all get another when one world needs its second.
        """
        if (which & self._used).any():
            self._draw()
        self._state = self._task.replace(self._to_jax(which), self._starts, self._state)
        self._seen = torch.where(which[:, None], self._first, self._seen)
        self._used = self._used | which
        self._failed, self._timed_out = self._failed & ~which, self._timed_out & ~which
        self.age = torch.where(which, 0, self.age)

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

    def _policy(self, seen: Tensor) -> Tensor:
        return seen[:, : self.observation_size]
