"""Bridge to vectorized environments with the interface of rsl_rl, such as those of Isaac Lab."""

from collections.abc import Callable, Mapping
from typing import Any, Self

import torch
from pydantic import PositiveFloat
from torch import Tensor

from ..errors import MorlaxError
from ..random import drawing_from
from .groups import actor_group, joined
from .interface import TimeStep, Worlds
from .options import ObjectiveOptions
from .section import Count

Make = Callable[[int, torch.device, int], Any]  # number of worlds, device and seed to a VecEnv
Read = Callable[[Any, dict[str, Any]], Mapping[str, Tensor]]  # VecEnv and extras to terms (N,)


def from_vecenv(
    make_env: Make,
    read_terms: Read,
    objectives: dict[str, dict[str, float]],
    reference_point: tuple[float, ...] | None = None,
    episode_length: int = 1000,
    action_scale: float = 1.0,
) -> type["VecEnvWorlds"]:
    """Return a class to `register`, whose worlds are a vectorized environment.

    The environment has `reset()`, and `step(actions)` that returns observations, rewards, dones and
    extras, on its own device, and starts new episodes by itself. Observations are a tensor, or
    groups of which policies see "actor" or "policy" and critics also "critic". A done in
    `extras["time_outs"]` is truncated. What an episode ended with is not shown, so
    `ppo.truncation` is mask.

    Args:
        make_env: returns an environment for a number of worlds, a device and a seed.
        read_terms: returns the reward terms (N,) of the last step, by name.
        objectives: weighted sums of reward terms, the default of `task.objectives`.
        reference_point: of the hypervolume (None: the origin).
        episode_length: the environment's own time limit, in steps.
        action_scale: factor on actions in [-1, 1], for environments without bounds.
    """

    groups, point, steps, factor = objectives, reference_point, episode_length, action_scale

    class Options(ObjectiveOptions):
        objectives: dict[str, dict[str, float]] = groups
        reference_point: tuple[float, ...] | None = point
        episode_length: Count = steps
        action_scale: PositiveFloat = factor

    members = {
        "Options": Options,
        "make_env": staticmethod(make_env),
        "read_terms": staticmethod(read_terms),
    }
    return type("VecEnvWorlds", (VecEnvWorlds,), members)


class VecEnvWorlds(Worlds):
    """N worlds of a vectorized environment; `from_vecenv` makes such classes.

    Without automatic reset, a world whose episode is over earns nothing. A world whose observation
    is not finite terminates with zero reward, if the environment ends its episode or not.
    """

    make_env: Any
    read_terms: Any
    shows_endings = False
    simulator = "a vectorized environment"
    options: Any

    def __init__(
        self, options: Any, num_worlds: int, device: torch.device, seed: int, auto_reset: bool
    ):
        self.options, self.num_worlds, self.device = options, num_worlds, device
        self.auto_reset, self.episode_length = auto_reset, options.episode_length
        self.generator = torch.Generator(device).manual_seed(seed)
        with drawing_from(self.generator):
            self.env = self.make_env(num_worlds, device, seed)
            self._check()
            self.action_size = int(self.env.num_actions)
            self._seen = self._features(self.env.reset())
            still = torch.zeros(num_worlds, self.action_size, device=device)
            _, _, _, extras = self.env.step(still)
            self.reward_terms = tuple(self.read_terms(self.env, extras))
        self.define_objectives()
        self.blowups = torch.zeros((), dtype=torch.int64, device=device)
        self._failed = torch.zeros(num_worlds, dtype=torch.bool, device=device)
        self._timed_out = torch.zeros_like(self._failed)
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
            raise MorlaxError(f"a vectorized environment has its own simulator: leave {wish} out.")
        return cls(options, num_worlds, device, seed, auto_reset)

    def reset(self) -> Tensor:
        with drawing_from(self.generator):
            self._seen = self._features(self.env.reset())
        self._failed = torch.zeros_like(self._failed)
        self._timed_out = torch.zeros_like(self._failed)
        return self._policy(self._seen)

    def restart(self, which: Tensor) -> Tensor:
        self.check_mask(which)
        if not which.all():
            raise MorlaxError("a vectorized environment restarts all of its worlds, or none.")
        return self.reset()

    def step(self, action: Tensor) -> TimeStep:
        standing = self._failed | self._timed_out
        with drawing_from(self.generator):
            actions = action.clamp(-1, 1) * self.options.action_scale
            found, _, dones, extras = self.env.step(actions)
            terms = self.read_terms(self.env, extras)
        seen = self._features(found)
        blown_up = ~seen.isfinite().all(1) | ~action.isfinite().all(1)
        seen = torch.where(blown_up[:, None], 0.0, seen)
        dones = dones.bool() | blown_up
        timed_out = extras.get("time_outs", torch.zeros_like(dones)).bool() & dones & ~blown_up
        failed = dones & ~timed_out
        paid = torch.stack([terms[name].float() for name in self.reward_terms], 1)
        paid = torch.where((standing | blown_up)[:, None], 0.0, paid)
        if not self.auto_reset:
            seen = torch.where(standing[:, None], self._seen, seen)
            failed = torch.where(standing, self._failed, failed)
            timed_out = torch.where(standing, self._timed_out, timed_out)
            blown_up = blown_up & ~standing
            self._failed, self._timed_out = failed, timed_out
        self._seen = seen
        self.blowups += blown_up.sum()
        return TimeStep(
            observation=self._policy(seen),
            reward=self._combine(paid),
            terminated=failed,
            truncated=timed_out,
            final_observation=self._policy(seen),
            terms=dict(zip(self.reward_terms, paid.unbind(1), strict=True)),
            critic_observation=seen,
            final_critic_observation=seen,
            blown_up=blown_up,
        )

    def critic_observation(self) -> Tensor:
        return self._seen.clone()

    def _check(self) -> None:
        worlds, device = self.env.num_envs, torch.device(self.env.device)
        if worlds != self.num_worlds or device.type != self.device.type:
            raise MorlaxError(
                f"the vectorized environment has {worlds} worlds on {device}, but there should be "
                f"{self.num_worlds} on {self.device}: let make_env pass both on."
            )

    def _features(self, found: Any) -> Tensor:
        groups = found[0] if isinstance(found, tuple) else found
        if isinstance(groups, Tensor):
            groups = {"actor": groups}
        actor = actor_group(groups, "the vectorized environment")
        seen = joined(groups, actor)
        self.observation_size = groups[actor].shape[1]
        self.privileged_size = seen.shape[1] - self.observation_size
        return seen

    def _policy(self, seen: Tensor) -> Tensor:
        return seen[:, : self.observation_size]
