"""One Gymnasium environment whose return values are checked."""

import sys
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Space
from numpy.typing import NDArray

from ..errors import MorlaxError, located

STEP = ("observation", "reward", "terminated", "truncated", "info")


def observation_size(name: str, space: Any) -> int:
    """Return how many numbers an observation of `space` has.

    Raises:
        MorlaxError: it is not a space, or not one of a fixed number of numbers.
    """
    if not isinstance(space, Space) or not space.is_np_flattenable:
        raise MorlaxError(
            f"{name} has observations without a fixed size ({space}): spaces such as Box, Discrete "
            "or a Dict of them are supported, Sequence and Graph are not."
        )
    size = gymnasium.spaces.flatdim(space)
    if not size:
        raise MorlaxError(f"{name} has empty observations ({space}): there is nothing to act on.")
    return size


class CheckedEnv:
    """An environment whose observations and rewards are flat arrays of the right sizes.

    Raises:
        MorlaxError: from every method, if the environment's code fails, ends the program, or
            returns values that do not fit its spaces.
    """

    def __init__(self, make: Callable[[], gymnasium.Env], name: str, num_rewards: int):
        self.name, self._rewards = name, (num_rewards,)
        self._file: str | None = None  # of the environment's class, for error messages
        self.env: gymnasium.Env = self._call("its constructor", make)
        module = sys.modules.get(type(self.env.unwrapped).__module__)
        self._file = getattr(module, "__file__", None)
        self.space = self.env.observation_space
        self._size = observation_size(name, self.space)

    def reset(self, seed: int | None) -> NDArray[np.float64]:
        """Start an episode; returns the observation (O,)."""
        found = self._call("reset()", self.env.reset, seed=seed)
        seen, _ = self._parts("reset()", found, ("observation", "info"))
        flat = self._flat("reset()", seen)
        if not (abs(flat) <= np.finfo(np.float32).max).all():
            raise MorlaxError(
                f"{self.name}: reset() returned an observation that is not finite in float32."
            )
        return flat

    def step(self, control: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64], bool, bool]:
        """Advance; returns the observation (O,), the reward (m,), terminated and truncated."""
        found = self._call("step()", self.env.step, control)
        seen, reward, terminated, truncated, _ = self._parts("step()", found, STEP)
        try:
            paid, ended, stopped = np.asarray(reward, np.float64), bool(terminated), bool(truncated)
        except (TypeError, ValueError) as error:
            raise MorlaxError(
                f"{self.name}: step() must return a reward of numbers, and terminated and "
                f"truncated as True or False: {located(error)}"
            ) from None
        if paid.shape != self._rewards:
            raise MorlaxError(
                f"{self.name}: step() returned a reward of shape {paid.shape}, but reward_space "
                f"has shape {self._rewards}: they must agree."
            )
        return self._flat("step()", seen), paid, ended, stopped

    def _call(self, method: str, function: Callable[..., Any], *values: Any, **named: Any) -> Any:
        try:
            return function(*values, **named)
        except (MorlaxError, MemoryError):
            raise
        except (Exception, SystemExit) as error:  # any error of the user's own code
            raise MorlaxError(
                f"{self.name}: {method} fails: {located(error, self._file)}"
            ) from error

    def _parts(self, method: str, found: Any, names: tuple[str, ...]) -> tuple[Any, ...]:
        if not isinstance(found, tuple) or len(found) != len(names):
            given = type(found).__name__
            if isinstance(found, tuple):
                given += f" of {len(found)}"
            raise MorlaxError(
                f"{self.name}: {method} must return a tuple ({', '.join(names)}), as Gymnasium's "
                f"environments do, not a {given}."
            )
        return found

    def _flat(self, method: str, seen: Any) -> NDArray[np.float64]:
        try:
            if isinstance(self.space, Box):
                flat, wanted = np.asarray(seen, np.float64), self.space.shape
            else:
                with np.errstate(over="ignore"):  # infinite numbers are the caller's to judge
                    found = gymnasium.spaces.flatten(self.space, seen)
                flat, wanted = np.asarray(found, np.float64), (self._size,)
        except Exception as error:  # each space fails in its own way
            raise MorlaxError(
                f"{self.name}: {method} returned an observation that does not fit its "
                f"observation_space {self.space}: {located(error)}"
            ) from None
        if flat.shape != wanted:
            raise MorlaxError(
                f"{self.name}: {method} returned an observation of shape {flat.shape}, but its "
                f"observation_space needs {wanted}."
            )
        return flat.reshape(-1)
