"""Worlds whose models differ: the same robot with another friction, other masses, other motors."""

import mujoco
import numpy as np
from mujoco import mjtBias, mjtGain
from mujoco.batch import MODEL_FIELDS, Batch

from .errors import MorlaxError
from .options import Randomization

LINEAR = [int(kind) for kind in (mjtGain.mjGAIN_FIXED, mjtGain.mjGAIN_AFFINE)]
LINEAR_BIAS = [int(kind) for kind in (mjtBias.mjBIAS_NONE, mjtBias.mjBIAS_AFFINE)]


def draw(
    model: mujoco.MjModel, options: Randomization, num_worlds: int, seed: int
) -> dict[str, np.ndarray]:
    """The fields (N, ...) of the model, by name, in which each world is to differ.

    Raises:
        MorlaxError: a field is none that worlds can differ in.
    """
    random, factors = np.random.default_rng(seed), {}

    def drawn(limits: tuple[float, float], *shape: int) -> np.ndarray:
        return random.uniform(*limits, (num_worlds, *shape))

    if options.friction:
        factor = drawn(options.friction, 1, 1)  # a contact takes the larger of two
        factors |= {"geom_friction": factor, "pair_friction": factor}
    if options.mass:
        factor = drawn(options.mass, model.nbody)
        factors |= {"body_mass": factor, "body_inertia": factor[..., None]}
    if options.strength:
        motors = [model.actuator(i).name for i in range(len(model.actuator_gaintype))]
        for name, gain, bias in zip(
            motors, model.actuator_gaintype, model.actuator_biastype, strict=True
        ):
            if int(gain) not in LINEAR or int(bias) not in LINEAR_BIAS:
                raise MorlaxError(
                    f"task.randomization.strength: the actuator {name!r} is no plain motor, "
                    "position or velocity servo: leave it out."
                )
        factor = drawn(options.strength, len(motors), 1)
        factors |= {"actuator_gainprm": factor, "actuator_biasprm": factor}
    for name, limits in options.fields.items():
        field = getattr(model, name, None) if name in MODEL_FIELDS else None
        if not isinstance(field, np.ndarray) or field.dtype.kind != "f" or not field.size:
            raise cannot("MuJoCo", name)
        factors[name] = drawn(limits, *field.shape) * factors.get(name, 1.0)
    products = {name: getattr(model, name) * factor for name, factor in factors.items()}
    return {name: values for name, values in products.items() if values.size}


def apply(batch: Batch, fields: dict[str, np.ndarray]) -> None:
    """Let the simulations of `batch` differ in `fields`, and in the constants that follow."""
    for name, values in fields.items():
        batch.expand(name)[:] = values
    batch.set_const()


def varying(
    model: mujoco.MjModel, num_worlds: int, fields: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """All fields (N, ...) in which the models differ then: `fields`, and those that follow."""
    batch = Batch(model, nsim=num_worlds)
    apply(batch, fields)
    found = {name: batch.expanded(name) for name in MODEL_FIELDS}
    return {
        name: values.copy()
        for name, values in found.items()
        if values is not None and (name in fields or (values != values[:1]).any())
    }


def cannot(simulator: str, field: str) -> MorlaxError:
    """The error for a field that a simulator cannot vary."""
    return MorlaxError(
        f"task.randomization.fields: {simulator} cannot let worlds differ in {field!r}: name "
        "an array of numbers of mujoco.MjModel that this robot has, such as dof_damping."
    )
