"""Errors for models that a simulator refuses, each with a remedy."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

from ..errors import MorlaxError, words

REMEDIES = {  # of what simulators say
    r"mjSOL_": 'set <option solver="Newton"/>, or model.opt.solver in load_model',
    r"mjINT_": 'set <option integrator="implicitfast"/>, or model.opt.integrator in load_model',
    r"mjCONE_": 'set <option cone="pyramidal"/>, or model.opt.cone in load_model',
    r"mj(?:ENBL|DSBL)_(\w+)": "leave {} out of <flag>",
    r"Dense is": 'set <option jacobian="sparse"/>, or model.opt.jacobian in load_model',
    r"noslip": 'set <option noslip_iterations="0"/>, or model.opt.noslip_iterations in load_model',
    r"(\w+) plugins": "leave the {} plugins out",
    r"out of memory|overflow": 'raise <size memory="100M"/> in the MJCF',
}
REFUSALS = NotImplementedError, ValueError, AttributeError, TypeError, KeyError
STOPS = mujoco.FatalError, RuntimeError  # while C MuJoCo steps


@contextmanager
def explained(simulator: str, errors: tuple[type[Exception], ...] = REFUSALS) -> Iterator[None]:
    """Raise MorlaxError, with a remedy, where a simulator refuses a model."""
    try:
        yield
    except errors as error:
        reason = words(error).removeprefix("NotImplementedError: ").removeprefix("ValueError: ")
        reason = reason.rstrip(".")
        remedy = "leave this out of the MJCF, or choose the other simulator with --backend"
        for pattern, advice in REMEDIES.items():
            if match := re.search(pattern, reason):
                remedy = advice.format(*(each.lower() for each in match.groups()))
                break
        raise MorlaxError(
            f"{simulator} cannot simulate this model ({reason}): {remedy}."
        ) from error
