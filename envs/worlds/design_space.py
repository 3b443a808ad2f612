"""Designs: numbers that the body of a robot depends on, and the bodies compiled from them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from mujoco import MjModel, MjSpec

from ..errors import MorlaxError, line, shortened, unknown, user_code
from .trees import forwarded

SIZES = "nq", "nv", "na", "nu", "nbody", "njnt", "ngeom", "nsite", "neq", "nsensordata"
DEPTH = 1e-3  # m that a body may penetrate more than the default body does at the start


class DesignParameter(NamedTuple):
    """A number of a robot's body, such as the length of a link."""

    default: float
    low: float
    high: float
    unit: str = "m"


class DesignSpace:
    """The designs (d,) that a robot's parameters span, by name, each from `low` to `high`."""

    def __init__(self, parameters: Mapping[str, DesignParameter]):
        self.parameters = {name: DesignParameter(*each) for name, each in parameters.items()}
        for name, (default, low, high, _) in self.parameters.items():
            if not (-np.inf < low < high < np.inf and low <= default <= high):
                raise MorlaxError(
                    f"the design parameter {name!r} goes from {low:g} to {high:g}, with the "
                    f"default {default:g}: it needs finite bounds, and a default between them."
                )
        columns = np.array([each[:3] for each in self.parameters.values()]).reshape(-1, 3).T
        self.default, self._low, self._high = columns

    def vector(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the design (d,) with these values by name, and defaults for the others."""
        design, names = self.default.copy(), list(self.parameters)
        if not isinstance(values, Mapping):
            example = dict(zip(names[:1], design.tolist(), strict=False))
            raise MorlaxError(
                f"a design is numbers by name, such as {example}, not {shortened(values)}."
            )
        for name, value in values.items():
            if name not in names:
                raise unknown("design parameter", str(name), names)
            if isinstance(value, bool | str) or np.shape(value) or not hasattr(value, "__float__"):
                raise MorlaxError(
                    f"the design parameter {name!r} must be a number, not {shortened(value)}."
                )
            _, low, high, unit = self.parameters[name]
            if not low <= value <= high:
                raise MorlaxError(
                    f"the design parameter {name!r} is {value:g} {unit}: it must be from {low:g} "
                    f"to {high:g} {unit}."
                )
            design[names.index(name)] = value
        return design

    def named(self, design: np.ndarray) -> dict[str, float]:
        """Return the values of a design (d,) by name."""
        return dict(zip(self.parameters, design.tolist(), strict=True))

    def scaled(self, designs: np.ndarray) -> np.ndarray:
        """Map designs (..., d) to numbers in [-1, 1], as networks see them."""
        return 2 * (designs - self._low) / (self._high - self._low) - 1

    def spread(self, number: int, seed: int) -> np.ndarray:
        """Return designs (number, d) that cover the space evenly: a scrambled Sobol sequence."""
        engine = torch.quasirandom.SobolEngine(len(self.default), scramble=True, seed=seed % 2**63)
        shares = engine.draw(number, dtype=torch.float32).double().numpy()
        return self._low + (self._high - self._low) * shares


class Bank(NamedTuple):
    """Bodies of D designs, to share out among worlds."""

    designs: np.ndarray  # (D, d)
    models: list[MjModel]
    starts: list[np.ndarray]  # positions (nq,) that episodes start from
    kept: np.ndarray  # (given,) bool, of the given designs: whether they compile and start freely


def compiled(task: Any, values: Mapping[str, float]) -> tuple[MjSpec, MjModel]:
    """Compile a robot, an `Environment`, with these values of its design parameters."""
    space = DesignSpace(task.designs)
    design, spec = space.named(space.vector(values)), task.load_spec()
    with user_code(f"{task.__name__}: {design} makes no body"):
        task.shape(spec, design)
        return spec, spec.compile()


def compile_bank(env: Any, designs: np.ndarray) -> Bank:
    """Compile the bodies of designs (D, d) of the robot in the worlds `env`, an `Environment`.

    A body starts as that of `env`, higher or lower by as much as its `qpos0` is.
    """
    task, base, spec = type(env), env.physics.model, env.load_spec()
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for texture in list(spec.textures):  # to draw them takes longer than all else
        spec.delete(texture)
    space, start = DesignSpace(task.designs), env.initial_qpos()
    deepest = _depth(base, start) + DEPTH
    models, starts, reason = [], [], "they start in the floor or in themselves"
    kept = np.zeros(len(designs), dtype=bool)
    for row, design in enumerate(designs):
        try:
            shaped = spec.copy()
            task.shape(shaped, space.named(design))
            model = task.prepared(shaped.compile(), env.options)
        except ValueError as error:
            reason = line(error).rstrip(".")
            continue
        for size in SIZES:
            if getattr(model, size) != getattr(base, size):
                raise MorlaxError(
                    f"{task.__name__}.shape changes {size} of the model from {getattr(base, size)} "
                    f"to {getattr(model, size)}: it may change numbers, not add or remove parts."
                )
        qpos = start + model.qpos0 - base.qpos0
        if _depth(model, qpos) <= deepest:
            kept[row] = True
            models.append(model)
            starts.append(qpos)
    if not models:
        raise MorlaxError(
            f"{task.__name__}: none of {len(designs)} designs makes a body: {reason}."
        )
    return Bank(designs[kept], models, starts, kept)


def _depth(model: MjModel, qpos: np.ndarray) -> float:
    """Return how far (m) the deepest contact penetrates at positions (nq,)."""
    return -float(forwarded(model, qpos).contact.dist.min(initial=0.0))
