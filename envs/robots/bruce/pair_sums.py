"""Coordinate maps in full precision, where a matrix product could be rounded to TF32."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


class PairSums:
    """A linear map from (N, C) to (N, R) in which every output has one or two terms.

    Args:
        matrix: (R, C), with at most two nonzero entries per row.
        like: tensor that sets dtype and device.
    """

    def __init__(self, matrix: NDArray[np.float64], like: Tensor):
        # The second largest entry of a row may be zero; it then adds nothing.
        columns = np.argsort(-np.abs(matrix), axis=1, kind="stable")[:, :2]
        self._columns = torch.from_numpy(columns.T.copy()).to(like.device)  # (2, R)
        self._factors = torch.from_numpy(np.take_along_axis(matrix, columns, 1).T.copy()).to(like)

    def __call__(self, values: Tensor) -> Tensor:
        return (values[:, self._columns] * self._factors).sum(1)
