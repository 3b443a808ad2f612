"""The cheetah with two to eight objectives, to see how learning scales with their number.

python benchmarks/compare.py --plan benchmarks/plans/objectives.yaml --output rows.csv
"""

from torch import Tensor

from morlax_torch.envs.robots.cheetah import Cheetah
from morlax_torch.envs.worlds.options import Objectives

JOINTS = ("back_thigh", "back_shin", "back_foot", "front_thigh", "front_shin", "front_foot")
SAVED = 4.0 / len(JOINTS)  # each joint's share of the energy that the cheetah saves at rest


class Many(Cheetah):
    """Run, keep the torso high, and spare the motors, each or in groups."""

    def terms(self) -> dict[str, Tensor]:
        spared = SAVED - self.physics.ctrl.square()
        joints = zip(JOINTS, spared.unbind(-1), strict=True)
        return {**super().terms(), **{f"spare_{name}": value for name, value in joints}}


def groups(number: int) -> dict[str, dict[str, float]]:
    """Return so many objectives: run, from three on the height, and the motors in groups."""
    objectives = {"run": {"run": 1.0}}
    if number > 2:
        objectives["height"] = {"height": 10.0}
    motors = number - len(objectives)
    for group in range(motors):
        joints = JOINTS[group::motors]
        objectives[f"motors {group + 1}"] = {f"spare_{name}": 1.0 for name in joints}
    return objectives


def robot(number: int) -> type[Many]:
    """Return the robot with so many objectives."""

    class Options(Cheetah.Options):
        objectives: Objectives = groups(number)

    return type("Robot", (Many,), {"Options": Options})


Two, Three, Four, Six, Eight = (robot(number) for number in (2, 3, 4, 6, 8))
