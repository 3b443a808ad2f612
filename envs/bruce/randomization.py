"""Robots that differ: each episode has masses, friction and motors of its own."""

import torch
from torch import Tensor

from ..physics import Physics

FIELDS = ("geom_friction", "body_mass", "body_ipos", "actuator_gainprm", "actuator_biasprm")
FRICTION, TORSO_MASS, GAIN = 0.4, 0.3, 0.2  # at most so much more, or less, of each
TORSO_SHIFT, SHIFT = 0.05, 0.01  # metres along each axis, of the torso's and every centre of mass


class Randomization:
    """Draws the model of each world anew; what MuJoCo derives from masses stays the nominal one.

    Args:
        physics: that has `FIELDS` varied.
    """

    def __init__(self, physics: Physics):
        self.fields = physics.varied
        self._nominal = {name: value.clone() for name, value in self.fields.items()}
        self._torso = physics.model.body("torso").id
        self._floor = physics.model.geom("floor").id

    def draw(self, fresh: Tensor, generator: torch.Generator) -> None:
        """Change the worlds where `fresh` (N,) bool."""

        def around_zero(width: float, *shape: int) -> Tensor:
            empty = self.fields["body_mass"].new_empty(len(fresh), *shape)
            return empty.uniform_(-width, width, generator=generator)

        drawn = {name: value.clone() for name, value in self._nominal.items()}
        drawn["geom_friction"][:, self._floor, 0] *= 1 + around_zero(FRICTION)
        drawn["body_mass"][:, self._torso] *= 1 + around_zero(TORSO_MASS)
        bodies = drawn["body_ipos"].shape[1]
        drawn["body_ipos"][:, 1:] += around_zero(SHIFT, bodies - 1, 3)
        drawn["body_ipos"][:, self._torso] += around_zero(TORSO_SHIFT, 3)
        gain = 1 + around_zero(GAIN, drawn["actuator_gainprm"].shape[1], 1)
        drawn["actuator_gainprm"] *= gain
        drawn["actuator_biasprm"] *= gain
        for name, value in self.fields.items():
            here = fresh.view(-1, *[1] * (value.ndim - 1))
            value.copy_(torch.where(here, drawn[name], value))
