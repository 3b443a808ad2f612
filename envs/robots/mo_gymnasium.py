"""The MuJoCo tasks of MO-Gymnasium, version 5: "A Toolkit for Reliable Benchmarking and Research
in Multi-Objective Reinforcement Learning", Felten et al., NeurIPS 2023.

Rewards, observations, terminations, frame skips, episode lengths and the size of the reset noise
match the originals; docs/tasks.md lists what differs, and tells how reference points are chosen.
"""

import mujoco
from pydantic import NonNegativeFloat
from torch import Tensor

from ..worlds.options import Count, Objectives, Point, TaskOptions
from .gymnasium_robot import GymnasiumHumanoid, GymnasiumRobot, HumanoidOptions, sense

STANDING = 1.25  # m, of the hopper


class SharedOptions(TaskOptions):
    objectives: Objectives = {"run": {"run": 1.0}, "control": {"ctrl_cost": -1.0}}
    episode_length: Count = 1000
    reset_noise: NonNegativeFloat = 0.1


class HalfCheetah(GymnasiumRobot):
    """mo-halfcheetah-v5: run fast, use little control. The robot never fails."""

    model_file = "half_cheetah.xml"
    substeps = 5

    class Options(SharedOptions):
        reference_point: Point = (-100.0, -6000.0)
        nconmax: int = 16


class Hopper(GymnasiumRobot):
    """mo-hopper-v5: run, jump high, use little control."""

    model_file = "hopper.xml"
    substeps = 4
    fastest_seen = 10.0

    class Options(SharedOptions):
        objectives: Objectives = {
            "run": {"run": 1.0},
            "jump": {"jump": 10.0},
            "control": {"ctrl_cost": -1.0},
        }
        shared: dict[str, float] = {"healthy": 1.0}
        reference_point: Point = (-100.0, -100.0, -3000.0)
        reset_noise: NonNegativeFloat = 0.005
        nconmax: int = 12
        njmax: int = 40

    def terms(self) -> dict[str, Tensor]:
        return {
            "healthy": self.healthy(),
            "run": self.speed(),
            "jump": self.physics.qpos[:, 1] - STANDING,
            "ctrl_cost": self.effort(),
        }

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        farthest = self.physics.qpos[:, 2:].abs().amax(-1)
        fastest = self.physics.qvel.abs().amax(-1)
        return ~((height > 0.7) & (pitch.abs() < 0.2) & (farthest < 100) & (fastest < 100))


class Hopper2(Hopper):
    """mo-hopper-2obj-v5: control is a small cost instead of an objective."""

    class Options(Hopper.Options):
        objectives: Objectives = {"run": {"run": 1.0}, "jump": {"jump": 10.0}}
        shared: dict[str, float] = {"healthy": 1.0, "ctrl_cost": -0.001}
        reference_point: Point = (-100.0, -100.0)


class Walker2d(GymnasiumRobot):
    """mo-walker2d-v5: run fast, use little control."""

    model_file = "walker2d_v5.xml"
    substeps = 4
    fastest_seen = 10.0

    class Options(SharedOptions):
        shared: dict[str, float] = {"healthy": 1.0}
        reference_point: Point = (-100.0, -6000.0)
        reset_noise: NonNegativeFloat = 0.005
        nconmax: int = 16

    def terms(self) -> dict[str, Tensor]:
        return {"healthy": self.healthy(), **super().terms()}

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        return ~((height > 0.8) & (height < 2.0) & (pitch.abs() < 1.0))


class Swimmer(GymnasiumRobot):
    """mo-swimmer-v5: swim fast, use little control. The robot never fails."""

    model_file = "swimmer.xml"
    substeps = 4
    unobserved = 2

    class Options(SharedOptions):
        reference_point: Point = (-100.0, -2000.0)
        nconmax: int = 1
        njmax: int = 4


class Ant(GymnasiumRobot):
    """mo-ant-v5: move along x, along y, use little control.

    Velocity is computed from `qpos`. The original uses the torso's body position, which the RK4
    integrator leaves at its last stage. Contact forces describe the state before the last physics
    step; the original's describe that last RK4 stage.
    """

    model_file = "ant.xml"
    substeps = 5
    unobserved = 2

    class Options(SharedOptions):
        objectives: Objectives = {
            "vx": {"vx": 1.0},
            "vy": {"vy": 1.0},
            "control": {"ctrl_cost": -1.0},
        }
        shared: dict[str, float] = {"healthy": 1.0, "contact_cost": -0.0005}
        reference_point: Point = (-100.0, -100.0, -8000.0)
        nconmax: int = 32
        njmax: int = 136
        include_cfrc_ext_in_observation: bool = True
        """Observe the contact forces on each body (78 numbers)."""

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        sense(spec)

    def contact_forces(self) -> Tensor:
        return super().contact_forces().clamp(-1, 1)

    def seen_of_bodies(self) -> dict[str, Tensor]:
        if not self.options.include_cfrc_ext_in_observation:
            return {}
        return {"contact_forces": self.contact_forces().flatten(1)}

    def terms(self) -> dict[str, Tensor]:
        vx, vy = self.velocity().unbind(-1)
        return {
            "healthy": self.healthy(),
            "contact_cost": self.contact_forces().square().sum((1, 2)),
            "ctrl_cost": self.effort(),
            "vx": vx,
            "vy": vy,
        }

    def failed(self) -> Tensor:
        height = self.physics.qpos[:, 2]
        return ~((height >= 0.2) & (height <= 1.0))


class Ant2(Ant):
    """mo-ant-2obj-v5: control is a cost instead of an objective."""

    class Options(Ant.Options):
        objectives: Objectives = {"vx": {"vx": 1.0}, "vy": {"vy": 1.0}}
        shared: dict[str, float] = {"healthy": 1.0, "contact_cost": -0.0005, "ctrl_cost": -0.5}
        reference_point: Point = (-100.0, -100.0)


class Humanoid(GymnasiumHumanoid):
    """mo-humanoid-v5: run fast, use little control."""

    class Options(HumanoidOptions):
        objectives: Objectives = {"run": {"run": 1.0}, "control": {"ctrl_cost": -1.0}}
        shared: dict[str, float] = {"healthy": 5.0, "contact_cost": -1.0}
        reference_point: Point = (-100.0, -2720.0)

    def terms(self) -> dict[str, Tensor]:
        contact = self.contact_forces().square().sum((1, 2))
        cost = (5e-7 * contact).clamp(max=10.0)
        return {"healthy": self.healthy(), "contact_cost": cost, **super().terms()}

    def failed(self) -> Tensor:
        height = self.physics.qpos[:, 2]
        return ~((height > 1.0) & (height < 2.0))
