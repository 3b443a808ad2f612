"""The functions of `episodes` as one Warp kernel each, where torch takes a dozen launches."""

import torch
import warp as wp

from .episodes import MAX_POSITION, MAX_VELOCITY, Ends

wp.set_module_options({"enable_backward": False})
FINITE = wp.constant(3.4028234663852886e38)  # the largest number in single precision


@wp.func
def _bounded(rows: wp.array2d(dtype=float), row: int, limit: float):
    """Whether every number of a row lies within [-limit, limit]; a NaN does not."""
    bounded = wp.bool(True)
    for i in range(rows.shape[1]):
        bounded = bounded and wp.abs(rows[row, i]) <= limit
    return bounded


@wp.func
def _copy(rows: wp.array2d(dtype=float), row: int, values: wp.array2d(dtype=float), world: int):
    for i in range(values.shape[1]):
        values[world, i] = rows[row, i]


@wp.func
def _clear(values: wp.array2d(dtype=float), world: int):
    for i in range(values.shape[1]):
        values[world, i] = 0.0


@wp.kernel
def _end(
    qpos: wp.array2d(dtype=float),  # (N, nq)
    qvel: wp.array2d(dtype=float),  # (N, nv)
    action: wp.array2d(dtype=float),  # (N, A)
    largest: wp.array(dtype=float),  # (N,) of the observation, in absolute value
    failed: wp.array(dtype=wp.bool),  # (N,)
    max_position: float,
    max_velocity: float,
    length: int,
    age: wp.array(dtype=int),  # (N,)
    reward: wp.array2d(dtype=float),  # (N, m)
    terms: wp.array2d(dtype=float),  # (N, terms)
    terminated: wp.array(dtype=wp.bool),  # (N,)
    truncated: wp.array(dtype=wp.bool),  # (N,)
    over: wp.array(dtype=wp.bool),  # (N,)
    blown_up: wp.array(dtype=wp.bool),  # (N,)
    blowups: wp.array(dtype=wp.int64),  # (1,)
):
    world = wp.tid()
    sane = _bounded(qpos, world, max_position) and _bounded(qvel, world, max_velocity)
    sane = sane and _bounded(action, world, FINITE) and _bounded(reward, world, FINITE)
    sane = sane and wp.isfinite(largest[world])
    if not sane:
        wp.atomic_add(blowups, 0, wp.int64(1))
        _clear(reward, world)
        _clear(terms, world)
    older = age[world] + 1
    age[world] = older
    fallen = failed[world] or not sane
    timed_out = older >= length
    blown_up[world] = not sane
    terminated[world] = fallen
    truncated[world] = timed_out and not fallen
    over[world] = fallen or timed_out


@wp.kernel
def _restart(
    over: wp.array(dtype=wp.bool),  # (N,)
    chosen: wp.array(dtype=wp.int64),  # (N,) rows of the starts
    start_qpos: wp.array2d(dtype=float),  # (B, nq)
    start_qvel: wp.array2d(dtype=float),  # (B, nv)
    start_ctrl: wp.array2d(dtype=float),  # (B, nu)
    start_sensors: wp.array2d(dtype=float),  # (B, nsensordata)
    qpos: wp.array2d(dtype=float),  # (N, nq)
    qvel: wp.array2d(dtype=float),  # (N, nv)
    ctrl: wp.array2d(dtype=float),  # (N, nu)
    act: wp.array2d(dtype=float),  # (N, na)
    warmstart: wp.array2d(dtype=float),  # (N, nv)
    sensors: wp.array2d(dtype=float),  # (N, nsensordata)
    age: wp.array(dtype=int),  # (N,)
):
    world = wp.tid()
    if over[world]:
        row = int(chosen[world])
        _copy(start_qpos, row, qpos, world)
        _copy(start_qvel, row, qvel, world)
        _copy(start_ctrl, row, ctrl, world)
        _copy(start_sensors, row, sensors, world)
        _clear(act, world)
        _clear(warmstart, world)
        age[world] = 0


def end(physics, action, observation, failed, length, age, reward, terms, blowups) -> Ends:
    """`episodes.end`."""
    ends = Ends(*(torch.empty_like(failed) for _ in Ends._fields))
    # a reduction of torch reads wide rows much faster than one thread per world would
    largest = torch.linalg.vector_norm(observation, torch.inf, dim=-1)
    before = [physics.qpos, physics.qvel, action.float(), largest, failed]
    after = [age, reward, terms, *ends, blowups.view(1)]
    limits = [MAX_POSITION, MAX_VELOCITY, length]
    _launch(_end, [*map(wp.from_torch, before), *limits, *map(wp.from_torch, after)])
    return ends


def restart(physics, over, starts, age) -> None:
    """`episodes.restart`."""
    state = [physics.qpos, physics.qvel, physics.ctrl, physics.act, physics.warmstart]
    _launch(_restart, [*map(wp.from_torch, [over, *starts, *state, physics.sensors, age])])


def _launch(kernel: wp.Kernel, inputs: list) -> None:
    wp.launch(kernel, inputs[0].shape[0], inputs, device=inputs[0].device)
