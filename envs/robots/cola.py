"""The tasks of COLA with three to five objectives: "COLA: Towards Efficient Multi-Objective
Reinforcement Learning with Conflict Objective Regularization in Latent Space", NeurIPS 2025.

Robots, observations, failures and episodes are those of PG-MORL's tasks. Rewards follow the
released code.
"""

from torch import Tensor

from ..worlds.options import Objectives
from . import pgmorl
from .runner import RunEnergy

LEGS = ("back right", "front left", "front right", "back left")  # as the ant's motors are ordered


def spared(controls: Tensor, cost: float) -> Tensor:
    """Return the reward (N,) for sparing some motors, given their controls (N, motors)."""
    return 4.0 - cost * controls.square().mean(-1)


class Ant3(pgmorl.Ant):
    """Ant-3d: move along x, along y, use little energy."""

    class Options(pgmorl.Ant.Options):
        objectives: Objectives = {"vx": {"vx": 1.0}, "vy": {"vy": 1.0}, "energy": {"energy": 1.0}}
        shared: dict[str, float] = {}

    def terms(self) -> dict[str, Tensor]:
        legs = zip(LEGS, self.physics.ctrl.unflatten(-1, (4, 2)).unbind(1), strict=True)
        return {
            **super().terms(),
            "energy": 4.0 - 0.5 * self.effort(),
            **{leg: spared(controls, 4.0) for leg, controls in legs},
        }


class Ant4(Ant3):
    """Ant-4d: move along x and spare the two motors of a leg, once for each leg."""

    class Options(Ant3.Options):
        objectives: Objectives = {leg: {"vx": 1.0, leg: 1.0} for leg in LEGS}


class Ant5(Ant3):
    """Ant-5d: move along x, spare the two motors of each leg."""

    class Options(Ant3.Options):
        objectives: Objectives = {"vx": {"vx": 1.0}, **{leg: {leg: 1.0} for leg in LEGS}}


class HalfCheetah5(pgmorl.HalfCheetah):
    """HalfCheetah-5d: run, jump, spare three pairs of motors.

    As in the released code, the front thigh belongs to two pairs and the front foot to none.
    """

    class Options(RunEnergy):
        objectives: Objectives = {
            "run": {"run": 0.5},
            "jump": {"height": 20.0},
            "thighs": {"thighs": 1.0},
            "back": {"back": 1.0},
            "front": {"front": 1.0},
        }

    def terms(self) -> dict[str, Tensor]:
        controls = self.physics.ctrl
        return {
            **super().terms(),
            "run": self.speed(),
            "height": self.physics.qpos[:, 1],
            "thighs": spared(controls[:, 0:4:3], 3.0),
            "back": spared(controls[:, 1:3], 3.0),
            "front": spared(controls[:, 3:5], 3.0),
        }


class Hopper5(pgmorl.Hopper):
    """Hopper-5d: run, jump, spare each of three motors."""

    class Options(pgmorl.Hopper.Options):
        objectives: Objectives = {
            "run": {"run": 1.5},
            "jump": {"jump": 12.0},
            **{motor: {motor: 1.0} for motor in ("thigh", "leg", "foot")},
        }
        shared: dict[str, float] = {"alive": 1.0}

    def terms(self) -> dict[str, Tensor]:
        thigh, leg, foot = (spared(control, 3.0) for control in self.physics.ctrl.split(1, -1))
        return {**super().terms(), "thigh": thigh, "leg": leg, "foot": foot}
