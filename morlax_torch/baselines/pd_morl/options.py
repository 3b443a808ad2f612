"""Options of PD-MORL."""

from typing import Any, ClassVar

from pydantic import Field, NonNegativeFloat, NonNegativeInt

from ...configuration.sections import OffPolicyOptions, check_end, check_multiple
from ...envs.worlds.options import Count


class PDMORLOptions(OffPolicyOptions):
    """Options of PD-MORL."""

    required: ClassVar[dict[str, Any]] = {
        "network.type": "conditioned",
        "sampling.mode": "sparse",
        "sampling.corners": 0,
        "ppo.critic": "vector",
    }
    updates: Count = 200
    """Gradient steps of the critics per iteration; must be a multiple of method.delay."""
    batch: Count = 256
    """Samples of a gradient step; must be a multiple of method.relabels + 1."""
    start: int = Field(default=5_000, gt=0, lt=2**40)
    """Transitions to store, with uniformly random actions, before the first gradient step."""
    learning_rate: float = Field(default=3e-4, gt=0, le=1)
    discount: float = Field(default=0.995, ge=0, le=1)
    target_rate: float = Field(default=0.005, gt=0, le=1)
    """Step of the target networks towards the networks, per gradient step of the actor."""
    delay: Count = 2
    """Gradient steps of the critics per gradient step of the actor."""
    relabels: NonNegativeInt = 3
    """Samples with a random trade-off per sample with the trade-off that acted."""
    exploration: float = Field(default=0.1, ge=0, le=1)
    """Standard deviation of the noise on actions in (-1, 1) that explore."""
    smoothing: float = Field(default=0.2, ge=0, le=1)
    """Standard deviation of the noise on actions in (-1, 1) that targets value."""
    clip: float = Field(default=0.5, ge=0, le=1)
    """Largest noise of method.smoothing."""
    warmup: float = Field(default=0.4, ge=0, le=1)
    """Share of max_env_steps or max_seconds for which only the key trade-offs, the corners and the
    balanced one, are trained, without angles in the losses."""
    refresh: int = Field(default=20_000, gt=0, lt=2**40)
    """Environment steps between evaluations of the key trade-offs."""
    critic_angle: NonNegativeFloat = 1.0
    """Weight of the angle in the critics' loss, per degree."""
    actor_angle: NonNegativeFloat = 10.0
    """Weight of the angle in the actor's loss, in units of weighted returns per degree."""

    @property
    def rounds(self) -> int:
        return self.updates // self.delay

    def check(self, ends: bool, clusters: int) -> None:
        check_end(ends)
        check_multiple("batch", self.batch, "method.relabels + 1", self.relabels + 1)
        check_multiple("updates", self.updates, "method.delay", self.delay)


OPTIONS = PDMORLOptions
