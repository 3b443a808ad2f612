"""Bridge to mjlab: N worlds of any of its tasks, with its reward terms by name."""

import contextlib
import io
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..devices import drawing_from
from ..physics import compiling
from .foreign import ACTORS, CRITIC, ForeignWorlds, Outcome, actor_group, joined
from .mjlab_tasks import MjlabOptions, changed, options_class

_rehearsed: set[str] = set()
ENDINGS = "endings"  # mjlab's name of the recorder
BLOWN_UP = "blown_up"  # of the termination


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

    def _open(self, seed: int) -> None:
        with drawing_from(self.generator):
            self.env = build(self.name, partial(self.config, seed), self.device)
            groups, _ = self.env.reset()
        self.reward_terms = tuple(self.env.reward_manager.active_terms)
        self._time_step = self.env.step_dt if self.env.cfg.scale_rewards_by_dt else 1.0
        self.actor_group = actor_group(groups, self.name)
        self.action_size = self.env.action_manager.total_action_dim
        self.observation_size = groups[self.actor_group].shape[1]
        self.privileged_size = joined(groups, self.actor_group).shape[1] - self.observation_size

    def config(self, seed: int) -> Any:
        """Return mjlab's config of these worlds."""
        cfg = changed(self.name, self.options, self.num_worlds, seed)
        cfg.auto_reset = self.auto_reset and not remembers(cfg)
        watch_endings(cfg)
        return cfg

    def _start(self) -> Tensor:
        with drawing_from(self.generator):
            seen = joined(self.env.reset()[0], self.actor_group)
        if self.auto_reset and self.options.stagger:
            ages = self.env.episode_length_buf
            ages.random_(0, self.episode_length, generator=self.generator)
        return seen

    def _restart(self, which: Tensor, seen: Tensor) -> Tensor:
        worlds = which.nonzero().squeeze(1)  # waits for the GPU
        if not len(worlds):
            return seen
        with drawing_from(self.generator):
            fresh = joined(self.env.reset(env_ids=worlds)[0], self.actor_group)
        return torch.where(which[:, None], fresh, seen)

    def _advance(self, action: Tensor) -> Outcome:
        with drawing_from(self.generator):
            groups, _, failed, timed_out, _ = self.env.step(
                action.clamp(-1, 1) * self.options.action_scale
            )
        if self.env.cfg.is_finite_horizon:
            failed, timed_out = failed | timed_out, torch.zeros_like(timed_out)
        timed_out = timed_out & ~failed
        over = failed | timed_out
        seen = final = joined(groups, self.actor_group)
        if not self.env.cfg.auto_reset:
            seen = self._restart(over, seen)  # mjlab steps no world whose episode is over
        elif (before := take_ending(self.env)) is not None:
            final = torch.where(over[:, None], joined(before, self.actor_group), final)
        terms = self.env.reward_manager._step_reward * self._time_step
        blown_up = self.env.termination_manager.get_term(BLOWN_UP).clone()
        return Outcome(seen, final, terms, failed.clone(), timed_out, blown_up)


def build(name: str, config: Callable[[], Any], device: torch.device) -> Any:
    """Return mjlab's environment. It draws from torch's global generators.

    `config` returns mjlab's config anew, which each environment changes. A task's kernels are
    compiled once in a process.
    """
    environment = import_module("mjlab.envs").ManagerBasedRlEnv

    def rehearse() -> None:
        env = environment(config(), device=str(device))
        env.reset()
        env.step(torch.zeros(env.num_envs, env.action_manager.total_action_dim))

    with contextlib.redirect_stdout(io.StringIO()):  # tables of all terms
        # on a GPU, torch could stop the process at an index that no kernel has written
        if device.type == "cpu" and name not in _rehearsed:
            _rehearsed.add(name)
            compiling.start(rehearse)
            compiling.finish()
        return environment(config(), device=str(device))


def watch_endings(cfg: Any) -> None:
    """Let worlds of this config show how episodes end, and terminate if they are not finite."""
    termination = import_module("mjlab.managers").TerminationTermCfg
    cfg.terminations[BLOWN_UP] = termination(func=_not_finite)
    if cfg.auto_reset:
        recorders = import_module("mjlab.managers.recorder_manager")
        cfg.recorders[ENDINGS] = recorders.RecorderTermCfg(func=_recorder())


def remembers(cfg: Any) -> bool:
    """Return whether an observation holds earlier or late ones, so that it is made only once."""
    return any(
        group.history_length
        or any(term.history_length or term.delay_max_lag for term in group.terms.values() if term)
        for group in cfg.observations.values()
        if group is not None
    )


def take_ending(env: Any) -> dict[str, Tensor] | None:
    """Return the observations before the restarts of the last step, if there were any."""
    recorder = env.recorder_manager.get_term(ENDINGS)
    groups, recorder.groups = recorder.groups, None
    return groups


def _not_finite(env: Any) -> Tensor:
    found: Tensor = import_module("mjlab.envs.mdp").nan_detection(env)
    return found | ~env.action_manager.action.isfinite().all(1)


@cache
def _recorder() -> type:
    """Return mjlab's kind of recorder, which sees all worlds just before some restart."""
    base = import_module("mjlab.managers.recorder_manager").RecorderTerm

    class Endings(base):
        groups: dict[str, Tensor] | None = None

        def record_pre_reset(self, env_ids: Tensor) -> None:
            manager = self._env.observation_manager
            used = {*ACTORS, CRITIC} & set(manager.active_terms)
            self.groups = {name: manager.compute_group(name) for name in used}

    return Endings
