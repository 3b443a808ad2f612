"""Options of PD-MORL."""

from typing import ClassVar

from pydantic import Field

from ...configuration.sections import OffPolicyOptions, check_multiple
from ...envs.worlds.options import Count


class PDMORLOptions(OffPolicyOptions):
    """Options of PD-MORL; its constants are those of the paper."""

    warms_up: ClassVar[bool] = True
    learning_rate: ClassVar[float] = 3e-4
    discount: ClassVar[float] = 0.995
    target_rate: ClassVar[float] = 0.005  # step of the target networks, per step of the actor
    delay: ClassVar[int] = 2  # gradient steps of the critics per gradient step of the actor
    relabels: ClassVar[int] = 3  # samples with a random trade-off per one with its own
    exploration: ClassVar[float] = 0.1  # standard deviation of noise on actions in (-1, 1)
    smoothing: ClassVar[float] = 0.2  # standard deviation of noise on the actions of targets
    clip: ClassVar[float] = 0.5  # largest such noise
    warmup: ClassVar[float] = 0.4  # share of the run for the key trade-offs, without angles
    critic_angle: ClassVar[float] = 1.0  # weight of the angle in the critics' loss, per degree
    actor_angle: ClassVar[float] = 10.0  # in the actor's loss, weighted returns per degree
    updates: Count = 200
    """Gradient steps of the critics per iteration; must be even."""
    batch: Count = 256
    """Samples of a gradient step; must be a multiple of 4."""
    refresh: int = Field(default=20_000, gt=0, lt=2**40)
    """Environment steps between evaluations of the key trade-offs."""

    def check(self, clusters: int) -> None:
        check_multiple("batch", self.batch, self.relabels + 1)
        check_multiple("updates", self.updates, self.delay)


OPTIONS = PDMORLOptions
