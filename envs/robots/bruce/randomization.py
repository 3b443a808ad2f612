"""BRUCE's domain randomization: masses, friction and motor gains of each world."""

import mujoco
import numpy as np
from numpy.typing import NDArray

FIELDS = ("geom_friction", "body_mass", "body_ipos", "actuator_gainprm", "actuator_biasprm")
FRICTION, TORSO_MASS, GAIN = 0.4, 0.3, 0.2  # largest relative change, up or down
# Shifts of centers of mass along each axis, in m; the torso gets both.
TORSO_SHIFT, SHIFT = 0.05, 0.01

Array = NDArray[np.float64]


def randomized(
    model: mujoco.MjModel, given: dict[str, Array], num_worlds: int, seed: int
) -> dict[str, Array]:
    """Draw the model fields (N, ...) that differ between worlds, by name.

    Args:
        model: the nominal robot.
        given: fields (N, ...) that already differ; they replace the nominal ones.
        num_worlds: N.
        seed: random seed.
    """
    random = np.random.default_rng([seed, 1])  # a stream independent of the one that drew `given`

    def around(center: float, width: float, *shape: int) -> Array:
        return random.uniform(center - width, center + width, (num_worlds, *shape))

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
