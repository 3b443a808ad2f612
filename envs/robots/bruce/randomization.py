"""Robots that differ: each world has masses, friction and motors of its own."""

import mujoco
import numpy as np
from numpy.typing import NDArray

FIELDS = ("geom_friction", "body_mass", "body_ipos", "actuator_gainprm", "actuator_biasprm")
FRICTION, TORSO_MASS, GAIN = 0.4, 0.3, 0.2  # at most so much more, or less, of each
TORSO_SHIFT, SHIFT = 0.05, 0.01  # metres along each axis, of the torso's and every centre of mass

Array = NDArray[np.float64]


def randomized(
    model: mujoco.MjModel, given: dict[str, Array], num_worlds: int, seed: int
) -> dict[str, Array]:
    """The fields (N, ...) that differ between worlds, over those that are `given`."""
    random = np.random.default_rng([seed, 1])  # not what `given` was drawn from

    def around(centre: float, width: float, *shape: int) -> Array:
        return random.uniform(centre - width, centre + width, (num_worlds, *shape))

    nominal = {name: [getattr(model, name)] * num_worlds for name in FIELDS}
    drawn = {name: np.array(values) for name, values in {**nominal, **given}.items()}
    torso = model.body("torso").id
    drawn["geom_friction"][:, model.geom("floor").id, 0] *= around(1, FRICTION)
    drawn["body_mass"][:, torso] *= around(1, TORSO_MASS)
    drawn["body_ipos"][:, 1:] += around(0, SHIFT, model.nbody - 1, 3)
    drawn["body_ipos"][:, torso] += around(0, TORSO_SHIFT, 3)
    gain = around(1, GAIN, model.nu, 1)
    drawn["actuator_gainprm"] *= gain
    drawn["actuator_biasprm"] *= gain
    return drawn
