"""N worlds as a TorchRL environment, with one reward per objective."""

from functools import partial
from typing import Any

import torch
from torch import Tensor

from .. import envs
from ..envs import MorlaxError
from ..envs.errors import require
from ..gpu.graph import Graph
from .gymnasium import Stepping

require("TorchRL", "torchrl", "0.14", "torchrl")

from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase


class TorchRLEnv(EnvBase):
    """N worlds of a task on the device, with batch size (N,).

    "observation" is (N, O), "action" (N, A) in [-1, 1], "reward" (N, m), and "done", "terminated"
    and "truncated" are (N, 1). TorchRL's `LineariseRewards` scalarizes the objectives.

    A world whose episode ended waits for a reset, and "_reset" can select some of the worlds. So
    ("next", "observation") is always the observation after the step. `rollout` and collectors
    reset worlds where needed.

    `set_seed` sets the random seed of the worlds, which is otherwise the same each time. `worlds`
    is the underlying morlax_torch environment. An unpickled copy starts from scratch.

    Args:
        task: one of `envs.names()`.
        num_envs: N.
        device, backend: as for `envs.make`.
        model_seed: as for `GymnasiumEnv`.
        task_options: as for `envs.make`, for example `episode_length=200`.

    Raises:
        MorlaxError: an unknown task or option, or a missing device.
    """

    def __init__(
        self,
        task: str,
        num_envs: int = 64,
        device: str | torch.device | None = None,
        backend: str | None = None,
        model_seed: int = 0,
        **task_options: Any,
    ):
        worlds = envs.make(
            task, num_envs, device, backend, model_seed, auto_reset=False, **task_options
        )
        super().__init__(device=worlds.device, batch_size=torch.Size([num_envs]))
        self.worlds, self.objectives = worlds, worlds.objectives
        self._arguments = (task, num_envs, str(worlds.device), backend, model_seed), task_options
        batch, device = self.batch_size, worlds.device

        def numbers(size: int) -> Unbounded:
            return Unbounded(torch.Size([*batch, size]), dtype=torch.float32, device=device)

        self.observation_spec = Composite(
            observation=numbers(worlds.observation_size), shape=batch, device=device
        )
        actions = torch.Size([*batch, worlds.action_size])
        self.action_spec = Bounded(-1, 1, actions, device, torch.float32)
        self.reward_spec = numbers(len(worlds.objectives))
        flag = Categorical(2, torch.Size([*batch, 1]), device=device, dtype=torch.bool)
        flags = {name: flag.clone() for name in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(flags, shape=batch, device=device)
        self._was_reset = False
        self._stepping = Stepping(worlds)
        self._which = torch.zeros(num_envs, dtype=torch.bool, device=worlds.device)
        self._restart = Graph(self._some_restart, worlds.device, [worlds.generator])
        if worlds.recordable:
            self._restart.record()

    def __reduce__(self) -> tuple[partial["TorchRLEnv"], tuple[()]]:
        # the worlds hold a simulator, which cannot be pickled
        positional, options = self._arguments
        return partial(type(self), *positional, **options), ()

    def to(self, device: str | torch.device) -> "TorchRLEnv":
        """Return the environment itself if it is already on the device; worlds cannot move."""
        if envs.resolve_device(device) != self.worlds.device:
            raise MorlaxError(f"worlds cannot move to {device}: pass device= to the constructor.")
        return self

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        which = None if tensordict is None else tensordict.get("_reset", None)
        self._was_reset = True
        if which is None:
            observation = self.worlds.reset().clone()  # it may be the memory of the simulator
        else:
            self._which.copy_(which.view_as(self._which))
            self._restart()
            observation = self._restarted.clone()
        over = torch.zeros_like(self._which)[:, None]
        return self._packed(observation, over, over)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        if not self._was_reset:
            raise MorlaxError("step was called before reset: call reset first.")
        observation, reward, terminated, truncated, _ = self._stepping(tensordict["action"])
        result = self._packed(observation, terminated[:, None], truncated[:, None])
        return result.set("reward", reward)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.worlds.reseed(seed)

    def _some_restart(self) -> None:
        self._restarted = self.worlds.restart(self._which)

    def _packed(self, observation: Tensor, terminated: Tensor, truncated: Tensor) -> TensorDict:
        flags = {"terminated": terminated.clone(), "truncated": truncated.clone()}
        values = {"observation": observation, "done": terminated | truncated, **flags}
        return TensorDict(values, batch_size=self.batch_size, device=self.worlds.device)
