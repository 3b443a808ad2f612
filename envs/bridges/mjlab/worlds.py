"""Bridge to mjlab: N worlds of any of its tasks, with its reward terms by name."""

import contextlib
import io
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from ...devices import drawing_from, global_generator
from ...physics import compiling
from ...worlds.mirror import Mirror
from ..foreign import (
    CRITIC,
    ForeignWorlds,
    Outcome,
    actor_group,
    joined,
)
from . import quantities
from .config import (
    MjlabOptions,
    changed,
    options_class,
    remembers,
)
from .endings import BLOWN_UP, take_ending, watch_endings
from .mirror import mirror_of
from .modes import SharedDraws
from .step import COMMAND, MaskedStep, supported

_rehearsed: set[str] = set()


@cache
def from_task(name: str) -> type["MjlabWorlds"]:
    """Return the class of "mjlab:TASK", a task of mjlab's registry.

    "mjlab:MODULE:TASK" imports the module first, which registers the task.

    Raises:
        MorlaxError: mjlab is missing or too old, or it has no such task.
    """
    return type("MjlabWorlds", (MjlabWorlds,), {"Options": options_class(name), "name": name})


class MjlabWorlds(ForeignWorlds):
    """N worlds of a task of mjlab, on MuJoCo Warp; `from_task` makes such classes.

    Policies see mjlab's group of observations "actor", critics also its group "critic". A reward
    term is what mjlab adds to its own reward: with its weight and its time step. mjlab draws from
    torch's global generators, which here have their own state for these worlds.

    With automatic reset, mjlab restarts worlds within its step. Their last observation is made
    where mjlab computes rewards: velocities and tilt of bodies are one physics step old, rays and
    commands one control step. Where an observation holds earlier ones, worlds are restarted by a
    second call instead, and nothing is old.
    """

    name: ClassVar[str]
    Options: ClassVar[type[MjlabOptions]]
    options: MjlabOptions
    simulator = "mjlab"
    needs_gpu = True

    def _open(self, seed: int) -> None:
        cfg = changed(self.name, self.options, self.num_worlds, seed)
        masked = supported(cfg) and not remembers(cfg)
        self.recordable = masked and self.device.type == "cuda"
        self._sharing: contextlib.AbstractContextManager[Any] = contextlib.nullcontext()
        if self.recordable:  # a recording draws from no other generator than torch's own
            self.generator = global_generator(self.device).manual_seed(seed)
        with drawing_from(self.generator):
            self.env = build(self.name, partial(self.config, seed), self.device)
            groups, _ = self.env.reset()
        self.reward_terms = tuple(self.env.reward_manager.active_terms)
        self.dt = self.env.step_dt
        self._time_step = self.dt if self.env.cfg.scale_rewards_by_dt else 1.0
        self.actor_group = actor_group(groups, self.name)
        self.action_size = self.env.action_manager.total_action_dim
        self.observation_size = groups[self.actor_group].shape[1]
        self.privileged_size = joined(groups, self.actor_group).shape[1] - self.observation_size
        manager = self.env.command_manager
        terms = [manager.get_term(name) for name in manager.active_terms]
        self._command = next((x for x in terms if type(x).__name__ == COMMAND), None)
        if self._command:
            self.quantities = quantities.NAMES
            self.lower_is_better = quantities.LOWER_IS_BETTER
        self._groups = tuple(name for name in (self.actor_group, CRITIC) if name in groups)
        self._step = MaskedStep(self.env, self._groups) if masked else None

    def config(self, seed: int) -> Any:
        """Return mjlab's config of these worlds."""
        cfg = changed(self.name, self.options, self.num_worlds, seed)
        cfg.auto_reset = self.auto_reset and not remembers(cfg)
        watch_endings(cfg)
        return cfg

    def share_draws(self, episodes: Tensor, number: int) -> None:
        super().share_draws(episodes, number)
        if self._step is None:
            return  # mjlab draws for some worlds at a time
        self._sharing = SharedDraws(episodes.to(self.device))
        with drawing_from(self.generator), self._sharing:
            if "startup" in self.env.event_manager.available_modes:
                self.env.event_manager.apply(mode="startup")

    def measure(self) -> Tensor:
        return quantities.measure(self._command)

    def quantify(self, means: np.ndarray) -> np.ndarray:
        return quantities.quantify(self.env.sim.mj_model, means)

    def mirror(self, tolerance: float = 0.0) -> Mirror:
        return mirror_of(self.env, self._groups, tolerance)

    def _start(self) -> Tensor:
        seen = self._reset()
        if self.auto_reset and self.options.stagger:
            ages = self.env.episode_length_buf
            ages.random_(0, self.episode_length, generator=self.generator)
        return seen

    def _restart(self, which: Tensor, seen: Tensor) -> Tensor:
        worlds = which.nonzero().squeeze(1)  # waits for the GPU
        if not len(worlds):
            return seen
        return torch.where(which[:, None], self._reset(worlds), seen)

    def _reset(self, worlds: Tensor | None = None) -> Tensor:
        """Reset worlds by index (None: all); returns what critics see in every world."""
        with drawing_from(self.generator), self._sharing:
            groups, _ = self.env.reset(env_ids=worlds)
        if self._step is not None:
            self._step.settle()
        return joined(groups, self.actor_group)

    def _advance(self, action: Tensor) -> Outcome:
        given = action.clamp(-1, 1) * self.options.action_scale
        if self._step is not None:
            with drawing_from(self.generator), self._sharing:
                groups, before, failed, timed_out = self._step(given)
            seen, final = (joined(each, self.actor_group) for each in (groups, before))
            return self._outcome(seen, final, failed, timed_out & ~failed)
        with drawing_from(self.generator):
            groups, _, failed, timed_out, _ = self.env.step(given)
        if self.env.cfg.is_finite_horizon:
            failed, timed_out = failed | timed_out, torch.zeros_like(timed_out)
        timed_out = timed_out & ~failed
        over = failed | timed_out
        seen = final = joined(groups, self.actor_group)
        if not self.env.cfg.auto_reset:
            seen = self._restart(over, seen)  # mjlab steps no world whose episode is over
        elif (before := take_ending(self.env)) is not None:
            final = torch.where(over[:, None], joined(before, self.actor_group), final)
        return self._outcome(seen, final, failed.clone(), timed_out)

    def _outcome(self, seen: Tensor, final: Tensor, failed: Tensor, timed_out: Tensor) -> Outcome:
        terms = self.env.reward_manager._step_reward * self._time_step
        blown_up = self.env.termination_manager.get_term(BLOWN_UP).clone()
        return Outcome(seen, final, terms, failed, timed_out, blown_up)


def build(name: str, config: Callable[[], Any], device: torch.device) -> Any:
    """Return mjlab's environment. It draws from torch's global generators.

    `config` returns mjlab's config anew, which each environment changes. A task's kernels are
    compiled once in a process.
    """
    environment = import_module("mjlab.envs").ManagerBasedRlEnv

    def rehearse() -> None:
        env = environment(config(), device=str(device))
        env.reset()
        shape = env.num_envs, env.action_manager.total_action_dim
        env.step(torch.zeros(shape, dtype=torch.float32))

    with contextlib.redirect_stdout(io.StringIO()):  # tables of all terms
        # on a GPU, torch could stop the process at an index that no kernel has written
        if device.type == "cpu" and name not in _rehearsed:
            _rehearsed.add(name)
            compiling.start(rehearse)
            compiling.finish()
        return environment(config(), device=str(device))
