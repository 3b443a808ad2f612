"""Bridge to vectorized environments with the interface of rsl_rl, such as those of Isaac Lab."""

from collections.abc import Callable, Mapping
from typing import Any
from weakref import WeakValueDictionary

import torch
from pydantic import PositiveFloat
from torch import Tensor
from torch.nn.functional import pad

from ..devices import drawing_from
from ..errors import MorlaxError, user_code
from ..worlds.options import Count, ObjectiveOptions, Objectives, Point
from .foreign import ForeignWorlds, Outcome

Make = Callable[[int, torch.device, int], Any]  # number of worlds, device and seed to a VecEnv
Read = Callable[[Any, dict[str, Any]], Mapping[str, Tensor]]  # VecEnv and extras to terms (N,)

NEEDED = (  # of an environment and its terms
    "num_envs, device, num_actions, reset(), step(actions) -> (observations, rewards, dones, "
    "extras) and read_terms(env, extras) -> terms"
)
# by the environment's id, the worlds that moved it last
_moved_by: "WeakValueDictionary[int, VecEnvWorlds]" = WeakValueDictionary()


def from_vecenv(
    make_env: Make,
    read_terms: Read,
    objectives: Objectives,
    reference_point: Point = None,
    episode_length: int = 1000,
    action_scale: float = 1.0,
) -> type["VecEnvWorlds"]:
    """Return a class to `register`, whose worlds are a vectorized environment.

    The environment has `reset()`, and `step(actions)` that returns observations, rewards, dones and
    extras, on its own device, and starts new episodes by itself. Observations are a tensor, or
    groups of which policies see "actor" or "policy" and critics also "critic". A done in
    `extras["time_outs"]` is truncated. What an episode ended with is not shown, so
    `ppo.truncation` is mask, and other libraries see the next episode's first observation instead.

    Where a process can have only one environment, as in Isaac Lab, `make_env` returns the same one
    again. Training and evaluations then take turns in it: an evaluation uses its first worlds, and
    all worlds start new episodes afterwards.

    Args:
        make_env: returns an environment for a number of worlds, a device and a seed. For an
            evaluation, it may have more worlds.
        read_terms: returns the reward terms (N,) of the last step, by name.
        objectives: weighted sums of reward terms, the default of `task.objectives`.
        reference_point: of the hypervolume (None: the origin).
        episode_length: the environment's own time limit, in steps.
        action_scale: factor on actions in [-1, 1], for environments without bounds.
    """
    groups, point, steps, factor = objectives, reference_point, episode_length, action_scale

    class Options(ObjectiveOptions):
        objectives: Objectives = groups
        reference_point: Point = point
        episode_length: Count = steps
        action_scale: PositiveFloat = factor

    functions = {"make_env": staticmethod(make_env), "read_terms": staticmethod(read_terms)}
    return type("VecEnvWorlds", (VecEnvWorlds,), {"Options": Options, **functions})


class VecEnvWorlds(ForeignWorlds):
    """N worlds of a vectorized environment; `from_vecenv` makes such classes."""

    make_env: Any
    read_terms: Any
    name = "the vectorized environment"
    shows_endings = False
    simulator = "a vectorized environment"
    options: Any

    def _open(self, seed: int) -> None:
        with drawing_from(self.generator):
            advice = "if it may build one environment only, let it return the same one again"
            with user_code(f"make_env fails; {advice}, since evaluations need it too"):
                self.env = self.make_env(self.num_worlds, self.device, seed)
            file = getattr(getattr(self.read_terms, "__code__", None), "co_filename", None)
            with user_code(f"{self.name} fails; {NEEDED} are needed", file):
                self._measure()

    def _measure(self) -> None:
        worlds, device = self.env.num_envs, torch.device(self.env.device)
        enough = worlds == self.num_worlds if self.auto_reset else worlds >= self.num_worlds
        if device.type != self.device.type or not enough:
            raise MorlaxError(
                f"{self.name} has {worlds} worlds on {device}, but there should be "
                f"{self.num_worlds} on {self.device}: let make_env pass both on, or lower "
                "evaluation.tradeoffs or evaluation.seeds."
            )
        self.action_size = int(self.env.num_actions)
        self._size(_by_group(self.env.reset()))
        still = torch.zeros(worlds, self.action_size, dtype=torch.float32, device=self.device)
        _, _, _, extras = self.env.step(still)
        self.reward_terms = tuple(dict(self.read_terms(self.env, extras)))

    @property
    def interrupted(self) -> bool:
        return _moved_by.get(id(self.env)) is not self

    def _restart(self, which: Tensor, seen: Tensor) -> Tensor:
        if not which.all():
            raise MorlaxError("a vectorized environment restarts all of its worlds, or none.")
        _moved_by[id(self.env)] = self
        with drawing_from(self.generator):
            return self._features(self.env.reset())

    def _advance(self, action: Tensor) -> Outcome:
        if self.interrupted:
            raise MorlaxError(
                "these worlds have been moved by others that share their environment, such as an "
                "evaluation's: reset them first."
            )
        with drawing_from(self.generator):
            actions = action.clamp(-1, 1) * self.options.action_scale
            actions = pad(actions, (0, 0, 0, self.env.num_envs - self.num_worlds))
            observation, _, dones, extras = self.env.step(actions)
            terms = self.read_terms(self.env, extras)
        seen = self._features(observation)
        columns = [self._column(name, terms.get(name)).float() for name in self.reward_terms]
        paid = torch.stack(columns, 1)
        # such a world terminates here, if the environment ends its episode or not
        blown_up = ~torch.cat([seen, paid, action], 1).isfinite().all(1)
        seen = torch.where(blown_up[:, None], 0.0, seen)
        dones = self._column("dones", dones).bool() | blown_up
        late = self._column("time_outs", extras.get("time_outs", torch.zeros_like(dones))).bool()
        timed_out = late & dones & ~blown_up
        return Outcome(seen, seen, paid, dones & ~timed_out, timed_out, blown_up)

    def _column(self, name: str, value: Any) -> Tensor:
        """Return the first N numbers of `value` if it has one for each world of the environment."""
        if not isinstance(value, Tensor) or value.shape != (self.env.num_envs,):
            kind = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
            raise MorlaxError(
                f"the vectorized environment gives {name} as {kind}: it must be a tensor of "
                f"shape ({self.env.num_envs},), one number for each world."
            )
        return value[: self.num_worlds]

    def _features(self, observation: Any) -> Tensor:
        return self._joined(_by_group(observation))[: self.num_worlds]


def _by_group(observation: Any) -> Any:
    if isinstance(observation, tuple):  # with extras, from a reset
        observation = observation[0]
    return {"actor": observation} if isinstance(observation, Tensor) else observation
