"""Bridge to mjlab: N worlds of any of its tasks, with its reward terms by name."""

import contextlib
import io
import warnings
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from operator import is_
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from ...devices import drawing_from, global_generator
from ...errors import MorlaxError
from ...physics import compiling
from ...worlds.mirror import Mirror
from ...worlds.options import Count, Objectives, Point
from ..foreign import ForeignWorlds, Outcome
from . import following
from .commands import MOTION, VELOCITY
from .config import EFFORT, MjlabOptions, changed, load
from .history import History, lengths
from .mirror import mirror_of
from .motion import files
from .step import MaskedStep, supported
from .walking import LOWER_IS_BETTER, QUANTITIES, Walking

BLOWN_UP = "blown_up"  # mjlab's name of the termination

_rehearsed: set[str] = set()


@cache
def from_task(name: str) -> type["MjlabWorlds"]:
    """Return the class of "mjlab:TASK", a task of mjlab's registry.

    "mjlab:MODULE:TASK" imports the module first, which registers the task. The default objectives
    are all rewards, and all costs. The reference point of costs is one per second.
    """
    cfg = load(name)
    weights = {term: value.weight for term, value in cfg.rewards.items() if value}
    gains = {term: 1.0 for term, weight in weights.items() if weight > 0}
    costs = {term: 1.0 for term, weight in weights.items() if weight < 0} or {EFFORT[0]: -1.0}
    seconds = cfg.episode_length_s
    steps = round(seconds / (cfg.sim.mujoco.timestep * cfg.decimation))

    class Options(MjlabOptions):
        objectives: Objectives = {"rewards": gains, "costs": costs}
        reference_point: Point = (0.0, -float(seconds))
        episode_length: Count = steps

    return type("MjlabWorlds", (MjlabWorlds,), {"Options": Options, "name": name})


class MjlabWorlds(ForeignWorlds):
    """N worlds of a task of mjlab, on MuJoCo Warp; `from_task` makes such classes.

    Policies see mjlab's group of observations "actor", critics also its group "critic". A reward
    term is what mjlab adds to its own reward: with its weight and its time step. mjlab draws from
    torch's global generators, which here have their own state for these worlds.

    A recordable step restarts worlds itself. Their last observation is made where mjlab computes
    rewards: velocities and tilt of bodies are one physics step old, rays and commands one control
    step. mjlab's own step is followed by a second call that restarts worlds, and nothing is old.
    """

    Options: ClassVar[type[MjlabOptions]]
    options: MjlabOptions
    simulator = "mjlab"
    needs_gpu = True
    restarts = True  # in the step that ends an episode, whether or not a caller restarts them

    def _open(self, seed: int) -> None:
        masked = supported(self.config(seed))
        if not masked and len(files(self.options.motion_file)) > 1:
            raise MorlaxError(
                f"{self.name} can follow one motion, not a folder of them, because its terms need "
                "mjlab's own step."
            )
        self.recordable = masked and self.device.type == "cuda"
        self._sharing: contextlib.AbstractContextManager[Any] = contextlib.nullcontext()
        if self.recordable:  # a recording draws from no other generator than torch's own
            self.generator = global_generator(self.device).manual_seed(seed)
        with drawing_from(self.generator):
            self.env = build(self.name, partial(self.config, seed), self.device)
            self._mix_ground()
            groups, _ = self.env.reset()
        self.reward_terms = tuple(self.env.reward_manager.active_terms)
        self.dt, self.age = self.env.step_dt, self.env.episode_length_buf
        self._time_step = self.dt if self.env.cfg.scale_rewards_by_dt else 1.0
        self._size(groups)
        self._remember()
        self.action_size = self.env.action_manager.total_action_dim
        manager = self.env.command_manager
        terms = {type(term).__name__: term for term in map(manager.get_term, manager.active_terms)}
        self._motion = terms.get(MOTION)
        self._measures: Any = None
        if VELOCITY in terms:
            self._measures = Walking(self.env, terms[VELOCITY])
            self.quantities, self.lower_is_better = QUANTITIES, LOWER_IS_BETTER
        elif self._motion and following.end_effectors(self.env.cfg):
            self._measures = following.Following(self.env, self._motion)
            self.follows_part = self.episode_length < self._motion.motion.time_step_total - 1
            self.quantities = self.lower_is_better = following.QUANTITIES
        self._step = MaskedStep(self.env, self.groups, self.restarts) if masked else None

    def _mix_ground(self) -> None:
        """Spread the kinds of uneven ground over the worlds, which mjlab puts in their order.

        Neighboring worlds share a trade-off, so the corners would know one kind alone.
        """
        terrain, number = self.env.scene.terrain, self.num_worlds
        if getattr(terrain, "terrain_origins", None) is not None:
            order = torch.arange(number, dtype=torch.float64, device=self.device)
            kinds = terrain.terrain_types[(order * following.GOLDEN % 1 * number).long()]
            terrain.terrain_types.copy_(kinds)
            terrain.env_origins.copy_(terrain.terrain_origins[terrain.terrain_levels, kinds])

    def _remember(self) -> None:
        manager, (actor, *_) = self.env.observation_manager, self.groups
        dims = zip(manager.active_terms[actor], manager.group_obs_term_dim[actor], strict=True)
        self.sizes = {name: torch.Size(dim).numel() for name, dim in dims}  # of each term's value
        self.lengths = lengths(self.sizes, self.options.sensors, self.options.history)
        parts = [*self.sizes.values(), self.privileged_size], [*self.lengths.values(), 1]
        self._history = History(*parts, self.num_worlds, self.device)
        self.observation_size = self._history.size - self.privileged_size

    def config(self, seed: int) -> Any:
        """Return mjlab's config of these worlds."""
        cfg = changed(self.name, self.options, self.num_worlds, seed)
        cfg.auto_reset = False  # `_restart` does it
        termination = import_module("mjlab.managers").TerminationTermCfg
        cfg.terminations[BLOWN_UP] = termination(func=_not_finite)
        return cfg

    def share_draws(self, episodes: Tensor, number: int) -> None:
        super().share_draws(episodes, number)
        if isinstance(self._measures, following.Following):
            self._measures.start(episodes, self.episode_length)
        elif self._step is None:
            return  # mjlab draws for some worlds at a time
        self.reseed(self.generator.initial_seed())  # for models that do not depend on N either
        self._sharing = SharedDraws(episodes.to(self.device), number)
        with drawing_from(self.generator), self._sharing:
            if "startup" in self.env.event_manager.available_modes:
                self.env.event_manager.apply(mode="startup")

    def measure(self) -> Tensor:
        return self._measures.measure()

    def quantify(self, means: np.ndarray, falls: np.ndarray) -> np.ndarray:
        return self._measures.quantify(means, falls)

    def mirror(self, tolerance: float = 0.0) -> Mirror:
        return mirror_of(self.env, self.groups, tolerance, self.lengths)

    def state_dict(self) -> dict[str, Any]:
        """Copy levels of ground and punches, and counts of failures, which take many episodes."""
        failures = {"failures": self._motion.bin_failed_count.clone()} if self._motion else {}
        return {"levels": [values.clone() for values in self._levels()], **failures}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore counts of failures, and restart all worlds at stored levels, if they have any."""
        if self._motion and "failures" in state:  # earlier versions did not save them
            self._motion.bin_failed_count.copy_(state["failures"])
        if levels := state["levels"]:
            self._set_levels(levels)
            self.reset()  # on the ground of these levels, which may change them
            self._set_levels(levels)

    def _set_levels(self, levels: list[Tensor]) -> None:
        for level, value in zip(self._levels(), levels, strict=True):
            level.copy_(value)

    def _levels(self) -> list[Tensor]:
        """Return the levels of difficulty of the worlds, (N,) each."""
        manager = self.env.action_manager
        terms = [manager.get_term(name) for name in manager.active_terms]
        punches = [term.level for term in terms if hasattr(term, "level")]
        ground = getattr(self.env.scene.terrain, "terrain_levels", None)
        return punches if ground is None else [ground, *punches]

    def _restart(self, which: Tensor, seen: Tensor) -> Tensor:
        worlds = which.nonzero().squeeze(1)  # waits for the GPU
        if not len(worlds):
            return seen
        with drawing_from(self.generator), self._sharing:
            groups, _ = self.env.reset(env_ids=worlds)
        if self._step is not None:
            self._step.settle()
        return torch.where(which[:, None], self._history.restart(which, self._joined(groups)), seen)

    def _advance(self, action: Tensor) -> Outcome:
        env, scaled = self.env, action.clamp(-1, 1) * self.options.action_scale
        if isinstance(self._measures, following.Following):
            self._measures.look()
        with drawing_from(self.generator), self._sharing:
            if self._step is not None:
                groups, before, failed, timed_out = self._step(scaled)
            else:
                groups, _, failed, timed_out, _ = env.step(scaled)
                before, failed = groups, failed.clone()
        if env.cfg.is_finite_horizon:
            failed, timed_out = failed | timed_out, torch.zeros_like(timed_out)
        timed_out, over = timed_out & ~failed, failed | timed_out
        values = self._joined(groups)
        restarted = over if self._step is not None and self.restarts else torch.zeros_like(over)
        last = torch.where(restarted[:, None], self._joined(before), values)
        final, seen = self._history.after(last), self._history.append(values, restarted)
        if self._step is None:
            seen = self._restart(over, seen)  # mjlab steps no world whose episode is over
        terms = env.reward_manager._step_reward * self._time_step
        blown_up = env.termination_manager.get_term(BLOWN_UP).clone()
        return Outcome(seen, final, terms, failed, timed_out, blown_up)


class SharedDraws(TorchDispatchMode):
    """Lets worlds of the same of `episodes` (N,) draw alike, wherever N rows are drawn at once.

    Only a row for each of `number` episodes is drawn, so draws do not depend on N.
    """

    def __init__(self, episodes: Tensor, number: int):
        super().__init__()
        self.rows, self.number = len(episodes), min(number, len(episodes))
        self.source = episodes % self.number

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs, fewer = kwargs or {}, args
        if torch.Tag.nondeterministic_seeded in func.tags:
            fewer = [self._fewer(value) for value in args]
        if all(map(is_, fewer, args)):
            return func(*args, **kwargs)
        shared = func(*fewer, **kwargs)[self.source]
        return args[0].copy_(shared) if func._schema.is_mutable else shared

    def _fewer(self, value: Any) -> Any:
        """Return the rows of N, or the shape of as many, to draw in their place."""
        if isinstance(value, Tensor) and value.shape[:1] == (self.rows,):
            return value[: self.number]
        if isinstance(value, list) and value[:1] == [self.rows]:
            return [self.number, *value[1:]]
        return value


def build(name: str, config: Callable[[], Any], device: torch.device) -> Any:
    """Return mjlab's environment of a new config, with most kernels compiled in parallel."""
    # tables of all terms; contacts with uneven ground that have only one point
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
        if name not in _rehearsed:
            _rehearsed.add(name)
            compiling.start(partial(step_physics, config(), str(device)))
            compiling.finish()
        return import_module("mjlab.envs").ManagerBasedRlEnv(config(), device=str(device))


def step_physics(config: Any, device: str) -> None:
    """Step and reset one world, as mjlab's `Simulation` does, without anything of torch.

    On a GPU, torch could stop the process at an index that no kernel has written.
    """
    import mujoco_warp as mjw
    import warp as wp

    config.scene.num_envs = 1
    model = import_module("mjlab.scene").Scene(config.scene, device=device).compile()
    config.sim.mujoco.apply(model)
    with wp.ScopedDevice(device):
        physics = mjw.put_model(model)
        config.sim.apply_wp_opt(physics.opt)
        size = {"nconmax": config.sim.nconmax, "njmax": config.sim.njmax}
        data = mjw.make_data(model, nworld=1, **size)
        mjw.step(physics, data)
        mjw.forward(physics, data)
        mjw.reset_data(physics, data, reset=wp.zeros(1, dtype=bool))
        wp.synchronize_device()  # Warp frees the spare data on another stream


def _not_finite(env: Any) -> Tensor:
    broken: Tensor = import_module("mjlab.envs.mdp").nan_detection(env)
    return broken | ~env.action_manager.action.isfinite().all(1)
