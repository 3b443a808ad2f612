"""mjlab's step of its tasks, without reading a GPU value on the CPU, so it can be recorded.

mjlab looks up which worlds are over, pushed or get a new command, and works on these alone. Here
every world draws, and a mask keeps what is due. Steps of the same state are equal; what is drawn
has the same distribution. mjlab's logs and metrics are left out.
"""

from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from typing import Any

import mujoco_warp
import torch
import warp as wp
from torch import Tensor
from torch.overrides import TorchFunctionMode

from ...worlds.episodes import refill
from .commands import COMMANDS

PUSH = "push_by_setting_velocity"
EVENTS = "reset_root_state_uniform", "reset_joints_by_offset", PUSH, "randomize_terrain"
LEVELS = "terrain_levels_vel"  # of the curriculum
STATE = ("qpos", "qvel", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied")  # of mj_data
MOCAP = "mocap_pos", "mocap_quat"  # of models with such bodies, which events move
SENSED = "sensor_subtree_vel", "sensor_rne_postconstraint"  # what MuJoCo Warp computes for sensors
PACKAGES = "mjlab.", __name__.removesuffix("step")

Groups = dict[str, Tensor]  # of observations, (N, ...) each


class MaskedStep:
    """Steps worlds of mjlab whose config is `supported`, and restarts them if it `restarts`."""

    def __init__(self, env: Any, groups: tuple[str, ...], restarts: bool = True):
        self.env, self.groups, self.restarts = env, groups, restarts
        self.slots: list[tuple[Any, Any, Tensor]] = []  # holder, key, tensor
        self._untouched: dict[str, set[tuple[int, Any]]] = {}  # by names of masked runs
        self.everyone = torch.arange(env.num_envs, device=env.device)
        manager = env.command_manager
        terms = [manager.get_term(name) for name in manager.active_terms]
        self.commands = [COMMANDS[type(term).__name__](term, self._masked) for term in terms]
        for sensor in env.scene.sensors.values():
            if hasattr(sensor, "_extract_yaw_rotation"):  # mjlab's looks for special cases
                sensor._extract_yaw_rotation = _yaw
        moved = MOCAP if env.sim.mj_model.nmocap else ()
        self.physics = [getattr(env.sim.data, name)[:] for name in (*STATE, *moved)]
        # another's action or sensor may read them in every step of physics
        readers = [*env.action_manager._terms.values(), *env.scene.sensors.values()]
        names = SENSED if all(type(x).__module__.startswith(PACKAGES) for x in readers) else ()
        self._sensed = {name: getattr(env.sim.wp_model, name) for name in names}
        self._constants = Constants()

    def __call__(self, action: Tensor) -> tuple[Groups, Groups, Tensor, Tensor]:
        """Step; returns observations, those before restarts, terminated and timed out (N,).

        Before restarts, velocities are one physics step old.
        """
        env, sim = self.env, self.env.sim
        _join_streams(sim)
        graphs, env.extras["log"] = sim.use_cuda_graph, {}
        # a recording cannot hold mjlab's own recordings
        sim.use_cuda_graph = graphs and not torch.cuda.is_current_stream_capturing()
        self.slots = [(holder, key, holder[key]) for holder, key in _slots(env)]
        with self._constants:
            env.action_manager.process_action(action)
            for left in reversed(range(env.cfg.decimation)):
                env.action_manager.apply_action()
                env.scene.write_data_to_sim()
                self._sense(left == 0)
                sim.step()
                env.scene.update(dt=env.physics_dt)
            env.episode_length_buf += 1
            over = env.termination_manager.compute()
            terminated = env.termination_manager.terminated.clone()
            timed_out = env.termination_manager.time_outs.clone()
            env.reward_buf = env.reward_manager.compute(dt=env.step_dt)
            self._disturb()
            ending = self._observe()
            if self.restarts:
                self._restart(over)
            elif not over.any():  # else a motion stays where the episode ended
                for command in self.commands:
                    command.go_on()
            sim.forward()
            for command in self.commands:
                command.pass_time(torch.where(over, 0.0, env.step_dt).float())
            sim.sense()
            groups = self._observe()
        self.settle()
        sim.use_cuda_graph = graphs
        return groups, ending, terminated, timed_out

    def _sense(self, read: bool) -> None:
        """Compute momenta and forces of bodies for sensors in steps after which they are read."""
        for name, value in self._sensed.items():
            setattr(self.env.sim.wp_model, name, value and read)

    def settle(self) -> None:
        """Put what mjlab has kept in new tensors into those that a recorded step reads."""
        for holder, key, value in self.slots:
            if (new := holder[key]) is not value and new.shape == value.shape:
                value.copy_(new)
                holder[key] = value

    def _observe(self) -> dict[str, Tensor]:
        return {name: self.env.observation_manager.compute_group(name) for name in self.groups}

    def _disturb(self) -> None:
        for term, left in self._intervals():
            left -= self.env.step_dt
            due = left < 1e-6
            refill(due, torch.empty_like(left).uniform_(*term.interval_range_s), left)
            self._masked(term.func.__name__, due, partial(self._run, term))

    def _intervals(self) -> Iterator[tuple[Any, Tensor]]:
        """Return events that happen at intervals, and the seconds until each, (N,)."""
        left = getattr(self.env.event_manager, "_interval_term_time_left", [])
        return zip(self._events("interval"), left, strict=True)

    def _events(self, mode: str) -> list[Any]:
        return self.env.event_manager._mode_term_cfgs.get(mode, [])

    def _restart(self, over: Tensor) -> None:
        """Start new episodes in the worlds of a mask (N,)."""
        env, sim = self.env, self.env.sim
        for term in getattr(env.curriculum_manager, "_term_cfgs", []):
            self._climb(over, **term.params)
        sim._reset_mask[:] = over
        with wp.ScopedDevice(sim.wp_device):
            mujoco_warp.reset_data(sim.wp_model, sim.wp_data, reset=sim._reset_mask_wp)

        def restart() -> None:
            env.scene.reset(self.everyone)
            for term in self._events("reset"):
                self._run(term)
            env.action_manager.reset(self.everyone)
            for manager in (env.reward_manager, env.termination_manager, env.observation_manager):
                for stateful in _resettable(manager):
                    stateful.reset(env_ids=self.everyone)
            env.episode_length_buf.zero_()

        self._masked("restart", over, restart)
        for term, left in self._intervals():
            refill(over, torch.empty_like(left).uniform_(*term.interval_range_s), left)
        for command in self.commands:
            command.restart(over)
        env.scene.write_data_to_sim()

    def _climb(self, over: Tensor, command_name: str) -> None:
        """Move robots of a mask (N,) up or down by one level of ground, by how far they walked."""
        terrain, twist = self.env.scene.terrain, self.env.command_manager.get_term(command_name)
        walked = (twist.robot.data.root_link_pos_w - terrain.env_origins)[:, :2].norm(dim=1)
        up = walked > terrain.cfg.terrain_generator.size[0] / 2
        wish = twist.command[:, :2].norm(dim=1) * self.env.max_episode_length_s
        terrain.update_env_origins(self.everyone, up & over, ~up & (walked < wish * 0.5) & over)

    def _run(self, term: Any) -> None:
        term.func(self.env, self.everyone, **term.params)

    def _masked(self, name: str, mask: Tensor, run: Callable[[], None]) -> None:
        """Let `run` change the worlds of a mask (N,): physics and tensors of mjlab with N rows.

        Tensors that a run of this `name` once left alone are left alone by all.
        """
        untouched = self._untouched.setdefault(name, set())
        rows = {}
        for holder, key in _slots(self.env):
            value, slot = holder[key], (id(holder), key)
            if value.ndim and len(value) == self.env.num_envs and slot not in untouched:
                rows[slot] = value
        state, others = [*self.physics, *rows.values()], ~mask
        before = [value.clone() for value in state]
        # how often PyTorch has written to each
        counts = {slot: x._version for slot, x in rows.items() if not x.is_inference()}
        run()
        untouched |= {slot for slot, count in counts.items() if rows[slot]._version == count}
        for value, old in zip(state, before, strict=True):
            refill(others, old, value)


class Constants(TorchFunctionMode):
    """Keeps tensors of numbers and indices, since a recording cannot copy these to a GPU."""

    def __init__(self) -> None:
        super().__init__()
        self._kept: dict[tuple[Any, ...], Tensor] = {}

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if func is torch.linalg.eigh:  # reads errors from the GPU; mjlab's own is for 3 x 3
            with self:
                return import_module("mjlab.envs.mdp.dr.body")._eigh_3x3_jacobi(*args)
        if func is torch.tensor:
            return self._keep((repr(args), repr(kwargs)), lambda: func(*args, **kwargs)).clone()
        if func in (Tensor.__getitem__, Tensor.__setitem__):
            of, index, *value = args
            parts = index if isinstance(index, tuple) else (index,)
            args = (of, tuple(self._there(part, of.device) for part in parts), *value)
            if value and isinstance(value[0], (bool, int, float)):
                kind = {"dtype": of.dtype, "device": of.device}
                filled = self._keep((*value, *kind.values()), lambda: torch.tensor(*value, **kind))
                args = (*args[:2], filled)
        return func(*args, **kwargs)

    def _there(self, index: Any, device: torch.device) -> Any:
        make = partial(torch.tensor, index, device=device)
        return self._keep((*index, device), make) if isinstance(index, list) else index

    def _keep(self, key: tuple[Any, ...], make: Callable[[], Tensor]) -> Tensor:
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]


def supported(cfg: Any) -> bool:
    """Return whether `MaskedStep` can step environments with this config."""
    events = [
        event.func.__name__ in EVENTS
        and event.mode != "step"
        and not event.is_global_time
        and not event.min_step_count_between_reset
        for event in cfg.events.values()
        if event is not None and event.mode != "startup"
    ]
    kinds = {f"{name}Cfg": kind for name, kind in COMMANDS.items()}
    commands = [
        (kind := kinds.get(type(command).__name__)) is not None and kind.supports(command)
        for command in cfg.commands.values()
    ]
    levels = [
        term.func.__name__ == LEVELS and [*term.params] == ["command_name"]
        for term in cfg.curriculum.values()
    ]
    late = [  # mjlab's buffers of delays move on the CPU
        actuator.delay_max_lag > 0
        for entity in cfg.scene.entities.values()
        if entity.articulation is not None
        for actuator in entity.articulation.actuators
    ]
    groups = [group for group in cfg.observations.values() if group is not None]
    checked = [group.nan_policy != "disabled" for group in groups]  # which waits for the GPU
    terms = [term for group in groups for term in group.terms.values() if term is not None]
    late += [term.delay_max_lag > 0 for term in terms]
    remembered = [bool(part.history_length) for part in (*groups, *terms)]  # seen only once a step
    unsupported = [*late, *checked, *remembered, cfg.is_finite_horizon]
    return all([*events, *commands, *levels]) and not any(unsupported)


def _yaw(frames: Tensor) -> Tensor:
    """Return rotations (B, 3, 3) around z, as far as the x axes of frames (B, 3, 3) are turned."""
    # where the x axis is upright, the y axis counts
    x, (left, right) = frames[:, :2, 0], frames[:, :2, 1].unbind(1)
    upright = x.norm(dim=1, keepdim=True) < 0.1
    ahead = torch.nn.functional.normalize(torch.where(upright, torch.stack([right, -left], 1), x))
    cos, sin = ahead.unbind(1)
    zero, one = torch.zeros_like(cos), torch.ones_like(cos)
    return torch.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], 1).view(-1, 3, 3)


def _resettable(manager: Any) -> list[Any]:
    """Return the stateful objects of a manager: terms, and models of observation noise."""
    groups = getattr(manager, "_group_obs_class_term_cfgs", None)
    if groups is None:
        return [term.func for term in manager._class_term_cfgs]
    terms = [term.func for group in groups.values() for term in group]
    noises = manager._group_obs_class_instances.values()
    return terms + [noise for group in noises for noise in group.values()]


def _join_streams(sim: Any) -> None:
    """Let writes to mjlab's arrays happen on the current stream, which may be recorded."""
    arrays = [sim._reset_mask]
    for bridge in (sim.data, sim.model):
        arrays += bridge._wrapped_cache.values()
    for array in arrays:
        if hasattr(type(array), "_setup_stream"):
            array._torch_stream = None


def _slots(root: Any) -> Iterator[tuple[Any, Any]]:
    """Find where mjlab's objects and those of a task keep tensors: containers and keys."""
    seen, waiting, packages = set(), [root], set[str]()
    while waiting:
        thing = waiting.pop()
        if id(thing) in seen:
            continue
        seen.add(id(thing))
        listed = isinstance(thing, (list, tuple))
        holder = thing if listed or isinstance(thing, dict) else getattr(thing, "__dict__", {})
        # others may have derived a class from mjlab's, or have written a term and what it needs
        modules = [f"{kind.__module__}." for kind in type(thing).__mro__]
        derived = any(module.startswith("mjlab.") for module in modules)
        derived = derived and not modules[0].startswith("mjlab.sim.")
        theirs = _package(thing) in packages - {"mjlab"} and not isinstance(thing, type)
        if derived:
            packages.add(_package(thing))
        if not (holder is thing or derived or theirs):
            continue
        for key, value in enumerate(holder) if listed else holder.items():
            if isinstance(value, Tensor):
                yield holder, key
            else:
                waiting.append(value)
                if key == "func":
                    packages.add(_package(value))


def _package(thing: Any) -> str:
    return str(getattr(thing, "__module__", "")).partition(".")[0]
