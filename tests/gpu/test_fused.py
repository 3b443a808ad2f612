"""Triton stays out of the way where it cannot help."""

import sys
import warnings

import pytest
import torch
from torch import nn

from morlax_torch import gpu
from morlax_torch.gpu import fused
from morlax_torch.networks.mlp import mlp, mlp_sizes


def test_without_triton_training_on_cuda_says_once_what_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "triton", None)
    monkeypatch.delitem(sys.modules, "morlax_torch.gpu.mlp_kernels", raising=False)
    monkeypatch.delattr(gpu, "mlp_kernels", raising=False)  # another test may have imported it
    fused.kernels.cache_clear()
    try:
        with pytest.warns(UserWarning, match="triton halted.*pip install triton") as said:
            assert not fused.kernels(torch.device("cuda"))
        assert len(said) == 1
        with warnings.catch_warnings(action="error"):
            assert not fused.kernels(torch.device("cuda"))
    finally:
        fused.kernels.cache_clear()


def test_only_mlps_have_sizes():
    twice = nn.Linear(4, 4)
    assert mlp_sizes(mlp(3, (5, 4), 2)) == (3, 5, 4, 2)
    assert mlp_sizes(nn.Sequential(nn.Linear(3, 5), nn.SiLU(), nn.Linear(5, 2))) == (3, 5, 2)
    for other in (
        nn.Linear(3, 2),
        nn.Sequential(nn.Linear(3, 5), nn.ELU(), nn.Linear(5, 2)),
        nn.Sequential(nn.Linear(3, 5, bias=False), nn.SiLU(), nn.Linear(5, 2)),
        nn.Sequential(nn.Linear(3, 5), nn.SiLU(), nn.Linear(5, 2), nn.SiLU()),
        nn.Sequential(twice, nn.SiLU(), twice),
        nn.GRUCell(3, 2),
    ):
        assert mlp_sizes(other) is None
