"""What the robots of other benchmarks share: MJCF that gymnasium ships, read where it lies."""

import math
from functools import cached_property
from importlib import resources
from typing import ClassVar

import mujoco
import numpy as np
import torch
from torch import Tensor

from ..worlds.environment import Environment
from ..worlds.layout import Part, positions, velocities


class GymnasiumRobot(Environment):
    """A robot of gymnasium's; an action of -1 or 1 is an end of its motor's range.

    An action outside [-1, 1] counts as its edge. The constraint solver is Newton's for every
    robot: MuJoCo Warp lacks the PGS that gymnasium's humanoid asks for.
    """

    unobserved: ClassVar[int] = 1  # leading positions: where on the floor it is
    fastest_seen: ClassVar[float] = math.inf  # observed velocities are clipped here

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        assets = resources.files("gymnasium") / "envs" / "mujoco" / "assets"
        with resources.as_file(assets / cls.model_file) as path:
            spec = mujoco.MjSpec.from_file(str(path))
        floor = spec.geom("floor")
        floor.size = [0.0, 0.0, 1.0]  # drawn without end, in squares of a metre
        spec.material(floor.material).texrepeat = [1.0, 1.0]
        spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        cls.edit(spec)
        total, spec.compiler.settotalmass = spec.compiler.settotalmass, -1.0
        model = spec.compile()
        if total > 0:  # kilograms: MuJoCo means to drop the compiler's own option, and warns
            mujoco.mj_setTotalmass(model, total)
            mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        """Change what a benchmark changes in gymnasium's robot, and add sensors."""

    @cached_property
    def control_range(self) -> tuple[Tensor, Tensor]:
        """(A,) the control that an action of zero means, and how far one of 1 is from there."""
        low, high = torch.from_numpy(self.physics.model.actuator_ctrlrange).to(self.physics.ctrl).T
        return (low + high) / 2, (high - low) / 2

    def initial_qpos(self) -> np.ndarray:
        return self.physics.model.qpos0.copy()

    def observe(self) -> Tensor:
        positions, velocities = self.physics.qpos[:, self.unobserved :], self.physics.qvel
        return torch.cat([positions, velocities.clamp(-self.fastest_seen, self.fastest_seen)], -1)

    def layout(self) -> list[Part]:
        model, fastest = self.physics.model, self.fastest_seen
        limit = fastest if math.isfinite(fastest) else None
        return [*positions(model)[self.unobserved :], *velocities(model, limit)]

    def apply(self, action: Tensor) -> None:
        middle, reach = self.control_range
        self.physics.ctrl.copy_(middle + reach * action.clamp(-1, 1))

    def place(self) -> Tensor:
        """(N, 2) where it is, in metres; its velocity is measured by this."""
        return self.physics.qpos[:, :2]

    def remember(self) -> dict[str, Tensor]:
        return {"place": self.place()}

    def velocity(self) -> Tensor:
        """(N, 2) the mean over the control step, in m/s."""
        return (self.place() - self.memory["place"]) / self.dt

    def effort(self) -> Tensor:
        """(N,) the sum of squared controls, in the units of the motors' ranges."""
        return self.physics.ctrl.square().sum(-1)

    def failed(self) -> Tensor:
        return torch.zeros_like(self.age, dtype=torch.bool)
