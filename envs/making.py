"""Worlds of a task by name."""

from numbers import Integral
from typing import Any

import torch

from .devices import resolve_device
from .errors import MorlaxError, shortened, unknown, validated
from .registry import get
from .worlds.environment import Environment
from .worlds.interface import Worlds
from .worlds.mujoco_robot import Robot


def make(
    name: str,
    num_worlds: int,
    device: str | torch.device | None = None,
    backend: str | None = None,
    seed: int = 0,
    *,
    auto_reset: bool = True,
    deterministic: bool = False,
    **task_options: object,
) -> Worlds:
    """Make N worlds of the task `name`.

    Args:
        name: one of `names()`, "FILE.py:CLASS" for your own task, "gymnasium:ID" for any
            environment in Gymnasium's registry with a vector reward, or "mjlab:TASK" for any task
            in mjlab's registry.
        num_worlds: N.
        device: "cuda", "cpu", "cuda:1", ...; None selects CUDA if there is a GPU.
        backend: "warp" (MuJoCo Warp), "mujoco" (C MuJoCo; CPU only) or None (chosen by device).
        seed: random seed of the worlds (most tasks draw nothing unless an option asks for it).
        auto_reset: start a new episode in the step that ended the last one.
        deterministic: make MuJoCo Warp order contacts and constraints alike in every run, at some
            cost in speed. CUDA runs then repeat closely, though not bit for bit.
        task_options: fields of the task's `Options`, for example `episode_length=200`.

    Raises:
        MorlaxError: an unknown name, option or backend, a number out of range, or a missing device.
    """
    task = get(name)
    options, chosen = validated(task.Options, task_options), resolve_device(device)
    if backend not in (None, "mujoco", "warp"):
        raise unknown("backend", str(backend), ("mujoco", "warp"))
    _check_integer("seed", seed, 0, 2**64 - 1, "2^64 - 1")
    _check_integer("num_worlds", num_worlds, 1, 2**31 - 1, "2147483647")  # of 32 bits
    kind = {"auto_reset": auto_reset, "deterministic": deterministic}
    with torch.device("cpu"):  # also if scripts set another default device
        return task.build(options, int(num_worlds), chosen, backend, int(seed), **kind)


def _check_integer(name: str, value: Any, least: int, most: int, limit: str) -> None:
    if not isinstance(value, Integral) or isinstance(value, bool):
        raise MorlaxError(f"{name} is {shortened(value)}: it must be an integer.")
    if not least <= int(value) <= most:
        raise MorlaxError(f"{name} is {value}: it must be from {least} to {limit}.")


def has_robot(name: str) -> bool:
    """Return whether `make_robot` can make one, so that a task can be shown and exported."""
    task = get(name)
    return issubclass(task, Environment) or getattr(task, "simulator", "") == "mjlab"


def make_robot(name: str, seed: int = 0, **task_options: Any) -> Robot:
    """Make one world of a MuJoCo robot on the CPU, without automatic reset, to look at."""
    if not has_robot(name):
        raise MorlaxError(
            f"{name} has no MuJoCo robot, so it cannot be shown, filmed or exported, nor be one "
            "world in gymnasium.make: train it, evaluate it, or use gymnasium.make_vec."
        )
    if not issubclass(task := get(name), Environment):
        from .bridges.mjlab.robot import robot_of

        robot: Any = robot_of(task)
        options = validated(robot.Options, task_options)
        return robot(options, 1, torch.device("cpu"), seed, auto_reset=False)
    env = make(name, 1, "cpu", "mujoco", seed, auto_reset=False, **task_options)
    assert isinstance(env, Environment)
    return env
