"""An exported policy, whose trade-off changes no faster than a limit."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...envs import MorlaxError
from ...envs.errors import installation
from ...host.files import read

Array = NDArray[np.float64]


class Policy:
    """An ONNX policy; `tradeoff` (m,) slides towards the `target` (m,) by at most `slew` per s.

    It stays as it is where the export has a fixed trade-off (`slides` is false).

    Raises:
        MorlaxError: onnxruntime is missing, or it cannot load the file.
    """

    def __init__(self, file: Path, objectives: Sequence[str], slew: float | None, seconds: float):
        try:
            import onnxruntime
        except ImportError:
            raise MorlaxError(
                f"play needs onnxruntime, which is not installed: {installation('onnx')}."
            ) from None
        content, options = read(file, "policy"), onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # the network is small
        try:
            self._session = onnxruntime.InferenceSession(content, options)
        except Exception as error:  # its own classes, which have no common base but this
            reason = " ".join(str(error).split())
            raise MorlaxError(f"onnxruntime cannot load {file}: {reason}.") from None
        self.objectives = tuple(objectives)
        self.slides = "tradeoff" in {value.name for value in self._session.get_inputs()}
        self._most = np.inf if slew is None else slew * seconds  # per control step
        self.tradeoff = self.target = np.full(len(objectives), 1 / len(objectives))

    def choose(self, target: Array, at_once: bool = False) -> None:
        """Slide towards a trade-off (m,) of weights that sum to one, or begin with it."""
        self.target = np.asarray(target, float)
        if at_once:
            self.tradeoff = self.target

    def act(self, observation: Array) -> Array:
        """Return the action (A,) for an observation (O,), one control step later in the slide."""
        way = self.target - self.tradeoff
        farthest = np.abs(way).max()
        self.tradeoff = self.tradeoff + way * min(1.0, self._most / max(farthest, 1e-12))
        inputs = {"observation": observation[None].astype(np.float32)}
        if self.slides:
            inputs["tradeoff"] = self.tradeoff.astype(np.float32)
        (actions,) = self._session.run(["action"], inputs)
        return np.asarray(actions, float)[0]
