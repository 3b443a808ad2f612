"""Copy many small tensors in one Triton kernel, for CUDA.

`torch._foreach_copy_` gives each tensor only a block per 65,536 numbers, and takes one dtype. This
module needs Triton, so import it only where there is CUDA.
"""

from collections.abc import Sequence
from itertools import accumulate

import torch
import triton
import triton.language as tl
from torch import Tensor

BLOCK = 1024  # numbers per program


@triton.jit
def _copy(targets, sources, FIRSTS: tl.constexpr, SIZES: tl.constexpr, B: tl.constexpr):
    program = tl.program_id(0)
    for j in tl.static_range(len(SIZES)):
        if (program >= FIRSTS[j]) & (program < FIRSTS[j + 1]):
            i = (program - FIRSTS[j]) * B + tl.arange(0, B)
            tl.store(targets[j] + i, tl.load(sources[j] + i, mask=i < SIZES[j]), mask=i < SIZES[j])


def copy(targets: Sequence[Tensor], sources: Sequence[Tensor]) -> None:
    """`fused.copy`."""
    sources = tuple(source.contiguous() for source in sources)
    sizes = tuple(source.numel() for source in sources)
    firsts = (0, *accumulate(triton.cdiv(size, BLOCK) for size in sizes))
    with torch.cuda.device_of(sources[0]):
        _copy[(firsts[-1],)](tuple(targets), sources, FIRSTS=firsts, SIZES=sizes, B=BLOCK)
