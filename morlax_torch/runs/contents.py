"""The schema of a checkpoint's contents."""

from typing import Annotated, Any, Self

import torch
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeInt,
    field_validator,
    model_validator,
)
from torch import Tensor

from ..envs.errors import shortened
from ..envs.worlds.design_space import DesignParameter
from ..envs.worlds.options import check_objectives
from .progress import Progress

FORMAT = 2

POLICY = ("actor.", "observation_normalizer.")  # beginnings of the names of what policies need

MOST_ITERATIONS = 2**53  # a float still counts them exactly

Size = Annotated[int, Field(ge=1, le=2**24)]


def _finite(values: dict[str, Tensor]) -> dict[str, Tensor]:
    for name, value in values.items():
        if value.is_floating_point() and not value.isfinite().all():
            raise ValueError(f"{name} is not finite")
    return values


def _with_agent(learner: dict[str, Any]) -> dict[str, Any]:
    agent = learner.get("agent")
    if not isinstance(agent, dict) or not all(isinstance(v, Tensor) for v in agent.values()):
        raise ValueError("a learner needs an agent, which consists of tensors by name")
    _finite(agent)
    return learner


def _plain(names: tuple[str, ...]) -> tuple[str, ...]:
    check_objectives(names)
    return names


class Task(BaseModel):
    objectives: Annotated[tuple[str, ...], AfterValidator(_plain)]
    observation_size: Size
    action_size: Size
    privileged_size: Annotated[int, Field(ge=0, le=2**24)] = 0
    designs: dict[str, DesignParameter] = {}
    model_fingerprint: dict[str, str] = {}
    """Of the MuJoCo model, see `models.fingerprint`; empty: unknown."""


class Contents(BaseModel):
    """Everything in a checkpoint: of a whole learner, or only of policies."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

    format: int
    config: dict[str, Any]
    environment: Task
    own_networks: dict[str, dict[str, list[NonNegativeInt]]] = {}
    """Parameter shapes of user-made networks: network -> parameter -> shape."""
    progress: Progress = Progress()
    learner: Annotated[dict[str, Any], AfterValidator(_with_agent)] | None = None
    """`Learner.state_dict()`, with the agent's tensors by name as "agent"."""
    policy: Annotated[dict[str, Tensor], AfterValidator(_finite)] | None = None
    """The agent's tensors without critics, instead of a learner."""

    @property
    def agent(self) -> dict[str, Tensor]:
        """The agent's tensors by name, without critics if there is no learner."""
        return self.learner["agent"] if self.learner else self.policy or {}

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.learner is None) == (self.policy is None):
            raise ValueError("it needs either a learner or policies")
        return self

    @field_validator("config")
    @classmethod
    def _of_a_task(cls, config: dict[str, Any]) -> dict[str, Any]:
        if not isinstance(config.get("env"), str):
            raise ValueError("env must name the task")
        return config


def check_state(stored: object, own: object, name: str = "state", listed: bool = False) -> None:
    """Check a state that a learner is about to load.

    Keys that only one of both has are left to the learner, which knows what it can do without.
    Tensors in lists (`listed`) may have another length.

    Raises:
        ValueError: a value has another type or shape, or is not finite.
    """
    if isinstance(own, dict) and isinstance(stored, dict):
        for key in own.keys() & stored.keys():
            check_state(stored[key], own[key], f"{name}.{key}")
    elif isinstance(own, list) and isinstance(stored, list):
        if len(own) != len(stored):
            raise ValueError(f"{name} has {len(stored)} entries instead of {len(own)}")
        for index, (value, mine) in enumerate(zip(stored, own, strict=True)):
            check_state(value, mine, f"{name}.{index}", listed=True)
    elif isinstance(own, Tensor) and isinstance(stored, Tensor):
        # on another device, Adam has another number of chunks, and a generator another state
        of_device = listed or own.dtype == torch.uint8
        same = stored.ndim == own.ndim if of_device else stored.shape == own.shape
        if not same or stored.is_floating_point() != own.is_floating_point():
            raise ValueError(
                f"{name} is {stored.dtype} {tuple(stored.shape)} instead of "
                f"{own.dtype} {tuple(own.shape)}"
            )
        _finite({name: stored})
    elif type(own) is not type(stored) or (
        isinstance(stored, int) and not 0 <= stored <= MOST_ITERATIONS
    ):
        raise ValueError(f"{name} is {shortened(stored)}")
