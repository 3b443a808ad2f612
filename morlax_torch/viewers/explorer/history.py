"""The last seconds of a robot's life, for strip charts."""

from collections import deque
from collections.abc import Sequence

import numpy as np

SECONDS = 15.0  # that are kept
INTERVAL = 0.05  # s between samples


class History:
    """Samples of a few signals, each the mean over `INTERVAL` of simulated time."""

    def __init__(self, signals: int):
        self._rows: deque[np.ndarray] = deque(maxlen=round(SECONDS / INTERVAL))
        self._pending: list[Sequence[float]] = []
        self._signals = signals
        self._begun = 0.0

    def add(self, time: float, values: Sequence[float]) -> None:
        """Note the signals at a simulated time in seconds, later than the last."""
        self._pending.append(values)
        if time - self._begun >= INTERVAL - 1e-9:
            self._rows.append(np.array([time, *np.mean(self._pending, axis=0)]))
            self._pending.clear()
            self._begun = time

    def columns(self) -> np.ndarray:
        """(1 + signals, T) the times, and each signal at them."""
        return np.array(self._rows).reshape(-1, 1 + self._signals).T.copy()
