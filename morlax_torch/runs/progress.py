"""Progress of a run: counters and evaluations."""

from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from ..evaluation.front import Front, hypervolume_in
from ..host.torchrun import launch
from .history import BEST


class Evaluation(NamedTuple):
    """One evaluation during training."""

    iteration: int
    env_steps: int
    train_seconds: float  # exploring and learning only
    total_seconds: float  # since the command began, over all sessions of the run
    steps_per_second: float  # environment steps per second of training, just before
    blowups: int  # how often a training world left sane bounds so far
    front: Front
    indicators: dict[str, float]  # by name
    selection: dict[str, float] | None = None  # of the episodes that choose; None: the same
    best: bool = False  # whether its checkpoint became best.pt

    @property
    def hypervolume(self) -> float:
        return self.indicators[hypervolume_in(self.indicators)]

    @property
    def measured(self) -> dict[str, float]:
        """The indicators that checkpoints, trials and so on are chosen by."""
        return self.indicators if self.selection is None else self.selection

    @property
    def selection_hypervolume(self) -> float:
        return self.measured[hypervolume_in(self.measured)]

    def row(self) -> dict[str, Any]:
        """Return the row of metrics.csv."""
        return {
            "iteration": self.iteration,
            "env_steps": self.env_steps,
            "train_seconds": round(self.train_seconds, 3),
            "total_seconds": round(self.total_seconds, 3),
            **self.indicators,
            "steps_per_second": round(self.steps_per_second),
            "blowups": self.blowups,
            BEST: int(self.best),
        }


class Progress(BaseModel):
    """A run's counters, updated in place while it trains and saved in checkpoints."""

    model_config = ConfigDict(allow_inf_nan=False)

    env_steps: int = 0
    processes: int = 1
    """How many trained together last."""
    launch: str = Field(default_factory=launch)
    """The start of `torchrun` that trained last."""
    train_seconds: float = 0.0
    """Time spent exploring and learning, without compiling, evaluating and saving."""
    total_seconds: float = 0.0
    """Wall-clock time since the command began, over all sessions of the run."""
    steps_per_second: float = 0.0
    blowups: int = 0
    """How often a training world left sane bounds."""
    hypervolume: float = 0.0
    """Of the latest evaluation, as reported."""
    best_hypervolume: float = 0.0
    """Of best.pt, as reported."""
    best_selection: float | None = None
    """Hypervolume of best.pt on the episodes that choose it (None: the next evaluation is best)."""
    evaluated: bool = True
    """Whether metrics.csv has the row of the checkpoint."""

    def improved(self, selection: float, hypervolume: float) -> bool:
        """Store the hypervolumes of an evaluation; returns whether it is the best so far.

        `selection` is that of the episodes that choose a checkpoint. Of equals, such as fronts that
        do not reach the reference point, the later one is the best: it was trained longer.
        """
        self.hypervolume = hypervolume
        best = self.best_selection is None or selection >= self.best_selection
        if best:
            self.best_selection, self.best_hypervolume = selection, hypervolume
        return best
