"""Bridge to Gymnasium: many copies of any `gymnasium.Env` with a vector reward, on the CPU."""

import importlib
import sys
from collections.abc import Callable
from functools import cache, partial
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box, Space
from pydantic import Field
from torch import Tensor

from ..errors import MorlaxError, user_code
from ..naming import GYMNASIUM
from ..worlds.options import Count, ObjectiveOptions, Objectives
from .foreign import ForeignWorlds, Outcome

UNLIMITED = 500  # steps per episode of an environment without a limit of its own
HALF = 2**30  # many environments take seeds below twice that only; evaluations have the upper half
LARGEST = np.finfo(np.float32).max


def from_gymnasium(make: Callable[[], gymnasium.Env], name: str = "") -> type["GymnasiumWorlds"]:
    """Return a class to `register`, whose worlds are environments from `make`.

    Its reward terms are the components of the vector reward, `reward_0`, `reward_1` and so on; by
    default each is an objective. An episode ends when the environment ends it, or after
    `episode_length` steps, by default the environment's own limit, or 500. If `reward_space` has
    bounds, the default reference point is the worst episode that they allow.

    Args:
        make: returns a new environment with a `reward_space` at each call.
        name: for error messages.

    Raises:
        MorlaxError: the actions are not a bounded Box, the reward is not a vector, or observations
            have no fixed size.
    """
    one = make()
    if not isinstance(one, gymnasium.Env):
        raise MorlaxError(f"make must return one gymnasium.Env, not {type(one).__name__}.")
    name = name or str(one)
    actions = getattr(one, "action_space", None)
    seen = getattr(one, "observation_space", None)
    rewards = one.get_wrapper_attr("reward_space") if one.has_wrapper_attr("reward_space") else None
    reason = ""
    if not isinstance(actions, Box) or not np.prod(actions.shape):
        reason = f"actions that are not continuous ({actions}): only a Box is supported"
    elif not actions.is_bounded():
        reason = "actions without bounds: give its Box a low and a high"
    elif not isinstance(rewards, Box) or len(rewards.shape) != 1 or rewards.shape[0] < 2:
        vector = "vector reward (a reward_space of two numbers or more)"
        reason = f"no {vector}, so there is nothing to trade off"
    elif not isinstance(seen, Space) or not seen.is_np_flattenable:
        supported = "spaces such as Box, Discrete or a Dict of them are supported"
        reason = f"observations without a fixed size ({seen}): {supported}"
    elif not gymnasium.spaces.flatdim(seen):
        reason = f"empty observations ({seen}): there is nothing to act on"
    if reason:
        raise MorlaxError(f"{name} has {reason}.")
    assert isinstance(actions, Box) and isinstance(rewards, Box)
    time = (one.spec and one.spec.max_episode_steps) or UNLIMITED
    terms = [f"reward_{i}" for i in range(rewards.shape[0])]

    class Options(ObjectiveOptions):
        # also of more terms than there can be objectives, for users who group them
        objectives: Objectives = Field({x: {x: 1.0} for x in terms}, validate_default=False)
        episode_length: Count = time

    one.close()
    members = {
        "Options": Options,
        "make_one": staticmethod(make),
        "name": name,
        "box": actions,
        "bounds": torch.from_numpy(np.stack([rewards.low, rewards.high])),
        "reward_terms": tuple(terms),
        "action_size": int(np.prod(actions.shape)),
        "observation_size": gymnasium.spaces.flatdim(seen),
    }
    return type("GymnasiumWorlds", (GymnasiumWorlds,), members)


@cache
def from_id(name: str) -> type["GymnasiumWorlds"]:
    """Return the class of "gymnasium:ID"; the id may name the module to import: "module:ID"."""
    identity = name.removeprefix(GYMNASIUM)
    if identity not in gymnasium.registry and ":" not in identity:
        try:
            importlib.import_module("mo_gymnasium")  # most users mean its environments
        except ImportError:
            raise MorlaxError(
                f"Gymnasium knows no {identity!r}: name the module that registers it, "
                f"{GYMNASIUM}MODULE:{identity}, or pip install mo-gymnasium."
            ) from None
    make = partial(gymnasium.make, identity, disable_env_checker=True)  # rewards are vectors
    with user_code(f"Gymnasium cannot make {identity!r}"):
        return from_gymnasium(make, name)


class GymnasiumWorlds(ForeignWorlds):
    """N environments, stepped one after the other; `from_gymnasium` makes such classes."""

    make_one: ClassVar[Callable[[], gymnasium.Env]]
    box: ClassVar[Box]  # of actions
    bounds: ClassVar[Tensor]  # (2, terms) of rewards
    simulator = "gymnasium"

    @classmethod
    def build(cls, options, num_worlds, device, backend, seed, *, auto_reset, deterministic):
        if device.type != "cpu" or backend == "warp":
            raise MorlaxError(f"{cls.name} runs only on the CPU: use --device cpu and no backend.")
        worlds = cls(options, num_worlds, device, seed, auto_reset)
        worlds.reseed(seed)  # the first `reset` starts from the seed, too
        return worlds

    def _open(self, seed: int) -> None:
        self._episodes = list(range(self.num_worlds))
        with self._explained("its constructor"):
            self._envs = [self.make_one() for _ in self._episodes]
        if len({id(env.unwrapped) for env in self._envs}) < self.num_worlds:
            raise MorlaxError(
                f"{self.name}: its worlds share one environment: make a new one at each call."
            )
        self._space = self._envs[0].observation_space
        dt = getattr(self._envs[0].unwrapped, "dt", None)  # MuJoCo's environments have it
        if isinstance(dt, float) and dt > 0:
            self.dt = dt
        # as environments give it
        self._observation = np.zeros((self.num_worlds, self.observation_size))
        self.reseed(seed)

    def define_objectives(self, dtype: torch.dtype = torch.float32) -> None:
        super().define_objectives(dtype)
        if self.options.reference_point is None:
            worst = (self.bounds[..., None] * self._weights).amin(0)  # (terms, m)
            worst = torch.where(worst.isfinite(), worst, 0.0).clamp(max=0.0)
            self.reference_point = tuple((worst.sum(0) * self.episode_length).tolist())

    def _restart(self, which: Tensor, seen: Tensor) -> Tensor:
        for world in which.nonzero().squeeze(1).tolist():
            env, seed = self._envs[world], self._seeds[world]
            self._seeds[world] = None  # later resets continue its random draws
            with self._explained("reset() -> (observation, info)", env):
                observation, _ = env.reset(seed=seed)
                self._observation[world] = self._flat(observation)
                if not (abs(self._observation[world]) <= LARGEST).all():
                    raise ValueError("an observation is not finite in float32")
        self.age.masked_fill_(which, 0)
        return torch.where(which[:, None], _in_float32(self._observation), seen)

    def _advance(self, action: Tensor) -> Outcome:
        low, high = self.box.low / 2, self.box.high / 2  # halved, the sum cannot overflow
        boxes = action.clamp(-1, 1).nan_to_num().numpy().reshape(-1, *self.box.shape)
        controls = high + low + (high - low) * boxes  # which rounding may take out of the box
        if np.issubdtype(self.box.dtype, np.integer):
            controls = controls.round()
        controls = controls.clip(self.box.low, self.box.high).astype(self.box.dtype)
        rewards = np.zeros((self.num_worlds, len(self.reward_terms)))
        failed, timed_out = torch.zeros(2, self.num_worlds, dtype=torch.bool, device="cpu")
        running = ~self._over.any(0) & action.isfinite().all(1)
        label = "step() -> (observation, reward, terminated, truncated, info)"
        for world in running.nonzero().squeeze(1).tolist():
            with self._explained(label, self._envs[world]):
                answer = self._envs[world].step(controls[world])
                observation, reward, terminated, truncated, _ = answer
                rewards[world] = _shaped("a reward", reward, rewards[world].shape)
                self._observation[world] = self._flat(observation)
                failed[world], timed_out[world] = bool(terminated), bool(truncated)
        final, paid = _in_float32(self._observation), _in_float32(rewards)
        blown_up = ~torch.cat([final, paid, action], 1).isfinite().all(1)
        self.age += 1
        failed |= blown_up
        timed_out = (timed_out | (self.age >= self.episode_length)) & ~failed
        seen = self._restart(failed | timed_out, final) if self.auto_reset else final
        return Outcome(seen, final, paid, failed, timed_out, blown_up)

    def reseed(self, seed: int) -> None:
        super().reseed(seed)
        seeds = [seed + episode for episode in self._episodes]
        self._seeds: list[int | None] = [x if x < HALF else HALF + x % HALF for x in seeds]

    def share_draws(self, episodes: Tensor, number: int) -> None:
        self._episodes = episodes.tolist()

    def _explained(self, label: str, env: gymnasium.Env | None = None) -> Any:
        """Name an environment's method that fails, or whose answer does not fit, and its line."""
        module = sys.modules.get(type(env and env.unwrapped).__module__)
        return user_code(f"{self.name}: {label} fails", getattr(module, "__file__", None))

    def _flat(self, observation: Any) -> np.ndarray:
        shape = self._space.shape
        if not isinstance(self._space, Box):
            shape = (self.observation_size,)
            with np.errstate(over="ignore"):  # infinite numbers are the caller's to judge
                observation = gymnasium.spaces.flatten(self._space, observation)
        return _shaped("an observation", observation, shape).reshape(-1)


def _shaped(what: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(values, np.float64)
    if array.shape != shape:
        raise ValueError(f"{what} of shape {array.shape}, not {shape}")
    return array


def _in_float32(values: np.ndarray) -> Tensor:
    with np.errstate(over="ignore"):  # infinite numbers end the episode
        return torch.from_numpy(values.astype(np.float32))
