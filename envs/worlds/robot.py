"""The interface between a MuJoCo robot and viewers, films and exports."""

from abc import abstractmethod
from typing import Protocol

import mujoco
from torch import Tensor

from .interface import Worlds
from .layout import Part


class State(Protocol):
    """A model, and the state of N worlds of it. Write to the state to move a robot."""

    model: mujoco.MjModel
    qpos: Tensor  # (N, nq)
    qvel: Tensor  # (N, nv)
    ctrl: Tensor  # (N, nu)
    act: Tensor  # (N, na)


class Robot(Worlds):
    """N worlds of a robot whose MuJoCo model is known."""

    dt: float  # seconds of a control step
    physics: State
    # Limits of each number of `command` (N, C), such as a velocity, by name. Anyone may write
    # `command` between steps.
    command_limits: dict[str, tuple[float, float]] = {}
    command: Tensor

    @abstractmethod
    def layout(self) -> list[Part]:
        """Name the parts of an observation, in order."""

    def targets(self) -> list[str] | None:
        """Return the joint of each action; None: actions are the model's actuators, in order."""
        return None

    def scales(self) -> tuple[list[float], list[float]] | None:
        """Return scale and offset of each action if its joint is to go to offset + scale * action.

        None: the mapping has another form, or actions are the model's actuators.
        """
        return None
