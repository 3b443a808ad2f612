"""Domain randomization: draw how the models of N worlds differ."""

import mujoco
import numpy as np
from mujoco import mjtBias, mjtGain

from ..errors import MorlaxError
from ..physics.batch import MODEL_FIELDS, cannot_vary
from .options import Randomization

LINEAR = [int(kind) for kind in (mjtGain.mjGAIN_FIXED, mjtGain.mjGAIN_AFFINE)]
LINEAR_BIAS = [int(kind) for kind in (mjtBias.mjBIAS_NONE, mjtBias.mjBIAS_AFFINE)]


def draw(
    model: mujoco.MjModel, options: Randomization, num_worlds: int, seed: int
) -> dict[str, np.ndarray]:
    """Draw the model fields (N, ...) that differ between worlds, by name.

    Raises:
        MorlaxError: worlds cannot differ in a requested field.
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
                    f"task.randomization.strength: the actuator {name!r} is not a plain motor, "
                    "position servo or velocity servo: leave it out."
                )
        factor = drawn(options.strength, len(motors), 1)
        factors |= {"actuator_gainprm": factor, "actuator_biasprm": factor}
    for name, limits in options.fields.items():
        field = getattr(model, name, None) if name in MODEL_FIELDS else None
        if not isinstance(field, np.ndarray) or field.dtype.kind != "f" or not field.size:
            raise cannot_vary("MuJoCo", name)
        factors[name] = drawn(limits, *field.shape) * factors.get(name, 1.0)
    products = {name: getattr(model, name) * factor for name, factor in factors.items()}
    return {name: values for name, values in products.items() if values.size}
