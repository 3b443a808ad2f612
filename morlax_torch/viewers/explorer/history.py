"""The last seconds of a robot's signals, for strip charts."""

from collections import deque
from collections.abc import Sequence

import numpy as np

SECONDS = 15.0  # length of the kept history
INTERVAL = 0.05  # s between samples


class History:
    """Samples of a few signals, each the mean over `INTERVAL` of simulated time."""

    def __init__(self, signals: int):
        self._rows: deque[np.ndarray] = deque(maxlen=round(SECONDS / INTERVAL))
        self._pending: list[Sequence[float]] = []
        self._signals = signals
        self._begun = 0.0
        self._ends: deque[float] = deque()  # s, of the samples before which episodes ended

    def add(self, time: float, values: Sequence[float]) -> None:
        """Add one sample.

        Args:
            time: simulated seconds, later than those of the previous sample.
            values: one per signal.
        """
        self._pending.append(values)
        if time - self._begun >= INTERVAL - 1e-9:
            self._rows.append(np.array([time, *np.mean(self._pending, axis=0)]))
            self._pending.clear()
            self._begun = time

    def end_episode(self) -> None:
        """Remember that the next sample belongs to a new episode."""
        if not self._rows or (self._ends and self._ends[-1] == self._rows[-1][0]):
            return
        self._ends.append(float(self._rows[-1][0]))
        self._pending.clear()  # a mean over two episodes would be neither's

    def ends(self) -> list[float]:
        """Return the times of the last sample of each episode that ended, in seconds."""
        while self._ends and self._ends[0] < self._rows[0][0]:
            self._ends.popleft()
        return list(self._ends)

    def columns(self) -> np.ndarray:
        """Return the times and, below them, each signal (1 + signals, T)."""
        return np.array(self._rows).reshape(-1, 1 + self._signals).T.copy()
