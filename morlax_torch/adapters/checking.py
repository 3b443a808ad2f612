"""What adapters share: checks of libraries and of what users pass, resets and steps."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib import metadata
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray
from torch import Size, Tensor

from .. import envs
from ..configuration.tradeoffs import one_tradeoff
from ..envs import MorlaxError, Worlds
from ..envs.errors import installation, shortened, unknown
from ..gpu.graph import Graph
from ..host.resources import one_thread


def require(name: str, package: str, least: str, extra: str) -> None:
    """Check that a library, PyPI's `package`, is installed by our `extra` and recent enough."""
    try:
        version = metadata.version(package)
    except metadata.PackageNotFoundError:
        version = "none"
    if [*map(int, re.findall(r"\d+", version)[:2])] < [*map(int, least.split("."))]:
        raise MorlaxError(
            f"{name} {least} or later is needed, but {version} is installed: {installation(extra)}."
        )


class UnknownOption(MorlaxError, TypeError):
    """An unknown option, also in Python's own words for an unexpected keyword argument.

    TorchRL's `GymEnv` first tries an option `frameskip`, and goes on without it after a TypeError
    with these words.
    """


def checked_actions(actions: Tensor | NDArray, shape: Size, device: torch.device) -> Tensor:
    """Check type, shape and device of actions, not their values; on the CPU, convert arrays."""
    if isinstance(actions, np.ndarray) and device.type == "cpu" and actions.dtype.kind in "biuf":
        actions = torch.from_numpy(np.array(actions, np.float32, order="C"))
    if not isinstance(actions, Tensor):
        raise MorlaxError(
            f"actions must be a torch tensor of numbers on {device}, not "
            f"{type(actions).__name__}: use torch.as_tensor(actions, device=envs.device), or wrap "
            "the environment in gymnasium.wrappers.vector.ArrayConversion."
        )
    if actions.shape != shape or actions.device != device:
        raise MorlaxError(
            f"actions need the shape {tuple(shape)}, one row per world, on {device}, but have "
            f"{tuple(actions.shape)} on {actions.device}."
        )
    return actions


class Stepping:
    """Steps worlds under a user's actions, on CUDA as a recorded graph."""

    def __init__(self, worlds: Worlds):
        self._worlds, self._device = worlds, worlds.device
        shape = worlds.num_worlds, worlds.action_size
        self._action = torch.zeros(shape, dtype=torch.float32, device=worlds.device)
        self._graph = Graph(self._advance, worlds.device, [worlds.generator])
        if worlds.recordable:
            self._graph.record()

    @torch.no_grad()
    def __call__(self, actions: Tensor | NDArray) -> tuple[Tensor, ...]:
        """Return the first five fields of a `TimeStep` under `checked_actions`."""
        self._action.copy_(checked_actions(actions, self._action.shape, self._device))
        with one_thread(self._device):
            self._graph()
        # a replayed graph overwrites the same memory in every step
        return tuple(value.clone() for value in self._time_step[:5])

    def _advance(self) -> None:
        self._time_step = self._worlds.step(self._action)


def one_seed(seeds: Sequence[int], number: int) -> int:
    """Mix the seeds of N worlds into one, because one generator draws for all of them."""
    try:
        if len(seeds) == number:
            return int(np.random.SeedSequence(seeds).generate_state(1, np.uint64)[0])
    except (TypeError, ValueError):
        pass
    needed = f"an integer from 0, or one for each of the {number} worlds"
    raise MorlaxError(f"the seed of reset must be {needed}, not {shortened(seeds)}.")


def box(size: int, limit: float = np.inf) -> gymnasium.spaces.Box:
    """Return the space of `size` numbers in [-limit, limit] of one world."""
    return gymnasium.spaces.Box(-limit, limit, (size,), np.float32)


class OneTask:
    """Rewards and resets, which one world and N worlds as Gymnasium environments share."""

    worlds: Worlds
    metadata: dict[str, Any]
    _spec: EnvSpec | None = None
    np_random: np.random.Generator  # Gymnasium's, which draws the seed of the worlds
    _weights: Tensor | None = None  # (m,)
    _was_reset = False

    @property
    def spec(self) -> EnvSpec | None:
        """How to make this environment again; None if Gymnasium did not make it."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        # The registered spec has no time limit, or Gymnasium would wrap this in a second one.
        self._spec = spec and replace(spec, max_episode_steps=self.worlds.episode_length)

    def _check(self, task: str, options: Iterable[str], render_mode: str | None) -> None:
        """Check the names of the render mode and of a task's options, not the options' values."""
        modes, fields = self.metadata["render_modes"], envs.get(task).Options.model_fields
        if render_mode not in (None, *modes):
            raise unknown("render mode", render_mode, modes)
        for name in options:
            if name not in fields:
                advice = unknown("option", name, fields)
                words = f"{task} got an unexpected keyword argument {name!r}"
                raise UnknownOption(f"{advice} ({words})")

    def _show(self, worlds: Worlds, tradeoff: Sequence[float] | None) -> None:
        self.objectives, self.reward_space = worlds.objectives, box(len(worlds.objectives))
        if tradeoff is not None:
            self.reward_space = None  # each reward is one number
            self._weights = one_tradeoff(tradeoff, worlds.objectives, worlds.device)

    def _restart(self, seed: int | None, options: dict[str, Any] | None) -> Tensor:
        """Reset the worlds after Gymnasium's own part; returns the observation (N, O)."""
        if options:
            raise MorlaxError(f"reset takes no options, but got {shortened(options)}.")
        if seed is not None or not self._was_reset:
            self.worlds.reseed(int(self.np_random.integers(2**63)))
        self._was_reset = True
        return self.worlds.reset()

    def _check_reset(self, call: str) -> None:
        if not self._was_reset:
            raise MorlaxError(f"{call} was called before reset: call reset first.")
