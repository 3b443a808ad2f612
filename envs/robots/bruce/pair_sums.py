"""Coordinate maps in full precision: a product of matrices may be rounded to TF32."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


class PairSums:
    """A linear map of which each result has one or two terms: (N, C) to (N, R).

    Args:
        matrix: (R, C), with at most two entries in a row that are not zero.
        like: whose dtype and device to take.
    """

    def __init__(self, matrix: NDArray[np.float64], like: Tensor):
        # the two largest entries of a row; one of them may be a zero
        columns = np.argsort(-np.abs(matrix), axis=1, kind="stable")[:, :2]
        self._columns = torch.from_numpy(columns.T.copy()).to(like.device)
        self._factors = torch.from_numpy(np.take_along_axis(matrix, columns, 1).T.copy()).to(like)

    def __call__(self, values: Tensor) -> Tensor:
        first, second = (values[:, columns] for columns in self._columns)
        return first * self._factors[0] + second * self._factors[1]
