"""Bridge to MuJoCo Playground: N worlds of any of its tasks, which JAX steps."""

import json
import os
import subprocess
import warnings
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import import_module
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..errors import MorlaxError, shortened, unknown, user_code
from ..worlds.options import Count, ObjectiveOptions, Objectives, Point
from .foreign import ForeignWorlds, Outcome, imported, require

POLICY, CRITIC = "state", "privileged_state"  # Playground's names of groups of observations
TERM = "reward/"  # before the names of reward terms in Playground's metrics
LIMITS = 1 << 9 | 1 << 10  # MuJoCo Warp's warnings of solvers and line searches at their limits
EFFORT = "action_l2"  # our own reward term, beside those of the task
UNLIMITED = 1000  # steps per episode of a task without a limit of its own

Value = bool | int | float | str | list[float]


class PlaygroundOptions(ObjectiveOptions):
    """The options of every task of Playground."""

    overrides: dict[str, Value] = {}
    """Changes to the task's own config by key, such as reward_config.scales.energy: -0.01."""
    stagger: bool = True


@cache
def from_task(name: str) -> type["PlaygroundWorlds"]:
    """Return the class of "playground:TASK", a task of MuJoCo Playground.

    "playground:MODULE:TASK" imports the module first, which registers the task.
    """
    steps = default_config(name).get("episode_length", UNLIMITED)

    class Options(PlaygroundOptions):
        objectives: Objectives = {"reward": {"reward": 1.0}, "effort": {EFFORT: -1.0}}
        reference_point: Point = (0.0, -float(steps))  # of the effort, under the largest actions
        episode_length: Count = steps

    return type("PlaygroundWorlds", (PlaygroundWorlds,), {"Options": Options, "name": name})


class PlaygroundWorlds(ForeignWorlds):
    """N worlds of a task of MuJoCo Playground, on MJX; `from_task` makes such classes.

    Policies see the observation, or its group "state"; critics also its group "privileged_state".
    Reward terms are the metrics "reward/NAME" as the task reports them (all metrics of a task
    without such names), then "reward", which is the task's own, and "action_l2", the mean of
    squared actions.
    """

    Options: ClassVar[type[PlaygroundOptions]]
    options: PlaygroundOptions
    simulator = "MuJoCo Playground"

    def _open(self, seed: int) -> None:
        cfg, device = default_config(self.name), self.device
        self._jax = import_module("jax")
        first = self._jax.devices()[0]
        kind = "cuda" if first.platform == "gpu" else first.platform
        if (kind, first.id) != (device.type, device.index or 0):
            raise MorlaxError(
                f"JAX runs on {kind}:{first.id}, and these worlds should run on {device}: set "
                "JAX_PLATFORMS=cpu for the CPU; a GPU needs pip install 'jax[cuda12]', and one "
                "that is not the first CUDA_VISIBLE_DEVICES."
            )
        overrides: dict[str, Value] = {}
        if "episode_length" in cfg:
            overrides["episode_length"] = self.options.episode_length
        if "impl" in cfg and device.type == "cpu":
            overrides["impl"] = "jax"  # small tasks are ten times as fast as with MJX's Warp
        overrides |= self.options.overrides
        self._task = task = _shared(self.name, json.dumps(overrides))
        self.observation_size, self.privileged_size = task.observation_size, task.privileged_size
        self.action_size, self.reward_terms = task.action_size, task.reward_terms
        self._used = torch.ones(self.num_worlds, dtype=torch.bool, device=device)

    def _restart(self, which: Tensor, seen: Tensor) -> Tensor:
        # A reset of one world costs as much as one of all, in some tasks as much as 200 steps. So
        # all worlds get a start in advance, and all get another when one world needs its second.
        if (which & self._used).any():
            self._draw()
        if which.all():
            self._state = self._starts
        else:
            self._state = self._task.replace(self._to_jax(which), self._starts, self._state)
        self._used = self._used | which
        self.age.masked_fill_(which, 0)
        return torch.where(which[:, None], self._first, seen)

    def _advance(self, action: Tensor) -> Outcome:
        control = self._to_jax(action.float().clamp(-1, 1))
        self._state, *parts = self._task.step(self._state, control)
        final, terms, failed = map(torch.from_dlpack, parts)
        return self._ended(action, final, terms, failed, False)

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


@cache
def _shared(name: str, overrides: str) -> "Functions":
    # worlds of one task share what JAX compiles: it can take a minute for each N
    return Functions(name, changed(name, json.loads(overrides)))


class Functions:
    """A task's environment without its own restarts; JAX compiles it for each number of worlds."""

    def __init__(self, name: str, cfg: Any):
        self.jax = jax = import_module("jax")
        with user_code(f"Playground cannot make {name}"), warnings.catch_warnings(action="ignore"):
            try:
                self._env = env = registry().load(name.rpartition(":")[2], config=cfg)
                _quiet(env)
                start = jax.eval_shape(env.reset, jax.random.PRNGKey(0))
                jax.eval_shape(env.step, start, jax.numpy.zeros(env.action_size))
            except subprocess.CalledProcessError:
                menagerie = "a robot of MuJoCo Menagerie, which git could not fetch from GitHub"
                raise MorlaxError(f"{name} needs {menagerie}.") from None
        groups = _groups(start.obs)
        sizes = [groups[key].shape for key in (POLICY, CRITIC) if key in groups]
        if POLICY not in groups or any(len(size) != 1 for size in sizes):
            raise MorlaxError(
                f"{name} shows {', '.join(groups)}, where policies need one vector, {POLICY}: they "
                "cannot take images."
            )
        self.observation_size = sizes[0][0]
        self.privileged_size = sum(size[0] for size in sizes[1:])
        self.action_size = int(self._env.action_size)
        metrics = list(start.metrics)
        self._metrics = [key for key in metrics if key.startswith(TERM)] or metrics
        names = [key.removeprefix(TERM) for key in self._metrics]
        self.reward_terms = (*names, "reward", EFFORT)
        self.reset = jax.jit(self._reset, static_argnums=0)
        self.step = jax.jit(self._step)
        self.replace = jax.jit(self._replace)

    def _reset(self, worlds: int, key: Any) -> tuple[Any, Any]:
        """Return a new state of N worlds, and its features (N, O + P)."""
        state = self._typed(self.jax.vmap(self._env.reset)(self.jax.random.split(key, worlds)))
        return state, self._features(state)

    def _step(self, state: Any, action: Any) -> tuple[Any, Any, Any, Any]:
        """Return the state after actions (N, A), its features, terms (N, terms) and failures."""
        jnp = self.jax.numpy
        state = self._typed(self.jax.vmap(self._env.step)(state, action))
        terms = [*(state.metrics[key] for key in self._metrics), state.reward, (action**2).mean(1)]
        columns = [term.astype(jnp.float32) for term in terms]
        return state, self._features(state), jnp.stack(columns, 1), state.done.astype(bool)

    def _replace(self, which: Any, fresh: Any, state: Any) -> Any:
        """Return a state with the worlds of a mask (N,) from `fresh`."""

        def chosen(new: Any, old: Any) -> Any:
            if old.shape[:1] != which.shape:
                return old  # MJX's Warp keeps the contacts of all worlds in one list
            return self.jax.numpy.where(which.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        return self.jax.tree.map(chosen, fresh, state)

    def _typed(self, state: Any) -> Any:
        # arrays made of Python's numbers have no type, and `step` would be compiled a second time
        typed = self.jax.lax.convert_element_type
        return self.jax.tree.map(lambda part: typed(part, part.dtype), state)

    def _features(self, state: Any) -> Any:
        groups, jnp = _groups(state.obs), self.jax.numpy
        parts = [groups[key].astype(jnp.float32) for key in (POLICY, CRITIC) if key in groups]
        return jnp.concatenate(parts, 1)


def _quiet(env: Any) -> None:
    """Let Warp print no line for every solver at its limit: tasks choose low limits."""
    try:
        warnings_of = env._mjx_model.opt._impl.warn_overflow
    except AttributeError:
        return  # MJX's JAX prints nothing
    quiet = {"opt._impl.warn_overflow": warnings_of & ~LIMITS}
    env._mjx_model = env._mjx_model.tree_replace(quiet)


def _groups(obs: Any) -> Mapping[str, Any]:
    return obs if isinstance(obs, Mapping) else {POLICY: obs}


def registry() -> Any:
    """Import Playground, and return its registry of tasks."""
    # by default, JAX takes three quarters of a GPU's memory, which torch needs too
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    require("MuJoCo Playground", "playground", "0.2", "playground")
    import warp as wp

    with warnings.catch_warnings(action="ignore"):  # its libraries use what JAX deprecates
        playground = import_module("mujoco_playground")
    wp.config.log_level = wp.LOG_WARNING  # MJX lets Warp report every kernel
    return playground.registry


def default_config(name: str) -> Any:
    """Return a copy of Playground's config of "playground:TASK" or "playground:MODULE:TASK"."""
    tasks, task = registry(), imported(name)
    suites = (tasks.dm_control_suite, tasks.locomotion, tasks.manipulation)
    names = [one for suite in suites for one in suite.ALL_ENVS]
    if task not in names:
        raise unknown("task of MuJoCo Playground", task, names)
    return tasks.get_default_config(task)


def changed(name: str, overrides: dict[str, Any]) -> Any:
    """Return the config of a task with changes, by key."""
    cfg = default_config(name)
    keys = list(_keys(cfg))
    for key, value in overrides.items():
        if key not in keys:
            raise unknown(f"key of the config of {name}", key, keys)
        try:
            cfg.update_from_flattened_dict({key: value})
        except (TypeError, ValueError):
            kind = type(cfg[key]).__name__
            raise MorlaxError(f"{key} of {name} must be {kind}, not {shortened(value)}.") from None
    return cfg


def _keys(cfg: Any, above: str = "") -> Iterable[str]:
    for key, value in cfg.items():
        yield from _keys(value, f"{above}{key}.") if hasattr(value, "items") else (above + key,)
