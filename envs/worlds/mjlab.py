"""Bridge to mjlab: N worlds of any of its tasks, with its reward terms by name."""

from functools import cache, partial
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from ..errors import MorlaxError
from ..random import drawing_from
from .groups import actor_group, joined
from .interface import TimeStep, Worlds
from .mjlab_building import build
from .mjlab_endings import BLOWN_UP, remembers, take_ending, watch_endings
from .mjlab_tasks import MjlabOptions, changed, options_class


@cache
def from_task(name: str) -> type["MjlabWorlds"]:
    """Return the class of "mjlab:TASK", a task of mjlab's registry.

    "mjlab:MODULE:TASK" imports the module first, which registers the task.

    Raises:
        MorlaxError: mjlab is missing or too old, or it has no such task.
    """
    return type("MjlabWorlds", (MjlabWorlds,), {"Options": options_class(name), "name": name})


class MjlabWorlds(Worlds):
    """N worlds of a task of mjlab, on MuJoCo Warp; `from_task` makes such classes.

    Policies see mjlab's group of observations "actor", critics also its group "critic". A reward
    term is what mjlab adds to its own reward: with its weight and its time step. mjlab draws from
    torch's global generators, which here have their own state for these worlds.

    With automatic reset, mjlab restarts worlds within its step. Their last observation is made
    where mjlab computes rewards: body positions are one physics step old. Where an observation
    holds earlier ones, worlds are restarted by a second call instead, and nothing is old.

    Without automatic reset, a world whose episode is over earns nothing and shows how it ended. A
    world that is not finite terminates with zero reward. The state of these worlds cannot be
    saved, so they start anew when a run is resumed.
    """

    name: ClassVar[str]
    Options: ClassVar[type[MjlabOptions]]
    options: MjlabOptions
    simulator = "mjlab"

    def __init__(
        self,
        options: MjlabOptions,
        num_worlds: int,
        device: torch.device,
        seed: int = 0,
        auto_reset: bool = True,
    ):
        self.options, self.num_worlds, self.device = options, num_worlds, device
        self.auto_reset, self.episode_length = auto_reset, options.episode_length
        self.generator = torch.Generator(device).manual_seed(seed)
        with drawing_from(self.generator):
            self.env = build(self.name, partial(self.config, seed), device)
            groups, _ = self.env.reset()
        self.reward_terms = tuple(self.env.reward_manager.active_terms)
        self.define_objectives()
        self._time_step = self.env.step_dt if self.env.cfg.scale_rewards_by_dt else 1.0
        self.actor_group = actor_group(groups, self.name)
        self.action_size = self.env.action_manager.total_action_dim
        self.observation_size = groups[self.actor_group].shape[1]
        self.privileged_size = joined(groups, self.actor_group).shape[1] - self.observation_size
        self.blowups = torch.zeros((), dtype=torch.int64, device=device)
        self._failed = torch.zeros(num_worlds, dtype=torch.bool, device=device)
        self._timed_out = torch.zeros_like(self._failed)
        self._seen = joined(groups, self.actor_group)
        self._stagger()

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
        if backend == "mujoco" or deterministic:
            wish = "--deterministic" if deterministic else "--backend mujoco"
            raise MorlaxError(f"{cls.name} runs on mjlab's own simulator: leave {wish} out.")
        return cls(options, num_worlds, device, seed, auto_reset)

    def config(self, seed: int) -> Any:
        """Return mjlab's config of these worlds."""
        cfg = changed(self.name, self.options, self.num_worlds, seed)
        cfg.auto_reset = self.auto_reset and not remembers(cfg)
        watch_endings(cfg)
        return cfg

    def reset(self) -> Tensor:
        with drawing_from(self.generator):
            self._seen = joined(self.env.reset()[0], self.actor_group)
            self._stagger()
        self._failed = torch.zeros_like(self._failed)
        self._timed_out = torch.zeros_like(self._timed_out)
        return self._policy(self._seen)

    def restart(self, which: Tensor) -> Tensor:
        self.check_mask(which)
        with drawing_from(self.generator):
            self._restart(which)
        self._failed = self._failed & ~which
        self._timed_out = self._timed_out & ~which
        return self._policy(self._seen)

    def step(self, action: Tensor) -> TimeStep:
        standing = self._failed | self._timed_out
        with drawing_from(self.generator):
            groups, _, failed, timed_out, _ = self.env.step(
                action.clamp(-1, 1) * self.options.action_scale
            )
            if self.env.cfg.is_finite_horizon:
                failed, timed_out = failed | timed_out, torch.zeros_like(timed_out)
            timed_out = timed_out & ~failed
            failed, over = failed.clone(), failed | timed_out
            blown_up = self.env.termination_manager.get_term(BLOWN_UP).clone()
            before, self._seen = self._seen, joined(groups, self.actor_group)
            final = self._ending(over, blown_up)
            if not self.env.cfg.auto_reset:
                self._restart(over)
        idle = standing | blown_up
        paid = self.env.reward_manager._step_reward * self._time_step
        paid = torch.where(idle[:, None], 0.0, paid)
        if not self.auto_reset:
            over = standing | failed | timed_out
            final = torch.where(standing[:, None], before, final)
            self._seen = torch.where(over[:, None], final, self._seen)
            failed = torch.where(standing, self._failed, failed)
            timed_out = torch.where(standing, self._timed_out, timed_out)
            self._failed, self._timed_out = failed, timed_out
            blown_up = blown_up & ~standing
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

    def _ending(self, over: Tensor, blown_up: Tensor) -> Tensor:
        """Return the observation after the step and before any restart, (N, O + P)."""
        final = self._seen
        if self.env.cfg.auto_reset and (groups := take_ending(self.env)) is not None:
            final = torch.where(over[:, None], joined(groups, self.actor_group), final)
        return torch.where(blown_up[:, None], 0.0, final)

    def _restart(self, which: Tensor) -> None:
        worlds = which.nonzero().squeeze(1)  # waits for the GPU
        if len(worlds):
            fresh = joined(self.env.reset(env_ids=worlds)[0], self.actor_group)
            self._seen = torch.where(which[:, None], fresh, self._seen)

    def _stagger(self) -> None:
        if self.auto_reset and self.options.stagger:
            ages = torch.randint(
                self.episode_length,
                (self.num_worlds,),
                generator=self.generator,
                device=self.device,
            )
            self.env.episode_length_buf[:] = ages

    def _policy(self, seen: Tensor) -> Tensor:
        return seen[:, : self.observation_size]
