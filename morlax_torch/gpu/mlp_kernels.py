"""A whole family's MLPs in one Triton kernel forward and one backward, for CUDA.

Row k of the packed parameters (K, P) holds network k: the weights and bias of each layer in turn,
weights rounded to TF32. A program keeps the weights of one network on chip and walks over a stretch
of its samples, so no activation leaves the chip; backward computes them again. Gradients are summed
in a fixed order, so results repeat bit for bit.

`torch.vmap` over `torch.func.functional_call` defines them. Import it only if there is CUDA.
"""

from collections.abc import Sequence
from functools import cache, partial
from itertools import pairwise
from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor
from torch.autograd.function import once_differentiable

INTERPRETED = triton.knobs.runtime.interpret  # on the CPU, for tests; it has no TF32
SMALLEST = 16  # side of the smallest matrix that tensor cores take
FORWARD_ROWS = 64  # samples per step of the forward kernel
PROGRAMS = 2  # of the forward kernel per multiprocessor
BLOCK = 1024  # numbers per program when packing


@triton.jit
def _round(x, TF32: tl.constexpr, ONCE: tl.constexpr = True):
    """Round to the nearest TF32; tensor cores would cut digits off.

    Not ONCE: round anew, where there are no registers to keep the first copy.
    """
    if TF32:
        return tl.inline_asm_elementwise(
            "cvt.rna.tf32.f32 $0, $1;", "=f,f", [x], dtype=tl.float32, is_pure=ONCE, pack=1
        )
    return x


@triton.jit
def _product(a, b, TF32: tl.constexpr):
    return tl.dot(a, b, input_precision="tf32" if TF32 else "ieee")


@triton.jit
def _layers(row, SIZES: tl.constexpr, PADDED: tl.constexpr):
    """Load the weights (outputs, inputs) and biases of one network, padded with zeros."""
    weights = ()
    biases = ()
    for i in tl.static_range(len(SIZES) - 1):
        outputs, inputs = tl.arange(0, PADDED[i + 1]), tl.arange(0, PADDED[i])
        inside = (outputs < SIZES[i + 1])[:, None] & (inputs < SIZES[i])[None, :]
        cell = row + outputs[:, None] * SIZES[i] + inputs[None, :]
        weights += (tl.load(cell, mask=inside, other=0.0),)
        row += SIZES[i + 1] * SIZES[i]
        biases += (tl.load(row + outputs, mask=outputs < SIZES[i + 1], other=0.0),)
        row += SIZES[i + 1]
    return weights, biases


@triton.jit
def _samples(x, first, stop, stride, SIZE: tl.constexpr, PADDED: tl.constexpr, ROWS: tl.constexpr):
    """Load samples (ROWS, PADDED) from `first` on, and zeros from `stop` on."""
    sample, column = first + tl.arange(0, ROWS), tl.arange(0, PADDED)
    inside = (sample < stop)[:, None] & (column < SIZE)[None, :]
    return tl.load(x + sample[:, None] * stride + column[None, :], mask=inside, other=0.0)


@triton.jit(do_not_specialize=("S", "stretch"))
def _forward(
    x,  # (K, S, O)
    packed,  # (K, P)
    y,  # (K, S, C)
    x_k,  # strides of x
    x_s,
    P,
    S,
    stretch,  # samples of a program
    SIZES: tl.constexpr,  # O, hidden layers, C
    PADDED: tl.constexpr,
    ROWS: tl.constexpr,
    TF32: tl.constexpr,
):
    k = tl.program_id(1).to(tl.int64)
    LAST: tl.constexpr = len(SIZES) - 2
    weights, biases = _layers(packed + k * P, SIZES, PADDED)
    start = tl.program_id(0) * stretch
    stop = tl.minimum(start + stretch, S)
    for first in tl.range(start, stop, ROWS, num_stages=1):
        a = _samples(x + k * x_k, first, stop, x_s, SIZES[0], PADDED[0], ROWS)
        for i in tl.static_range(LAST):
            z = _product(_round(a, TF32), tl.trans(weights[i]), TF32) + biases[i][None, :]
            a = z * tl.sigmoid(z)
        z = _product(_round(a, TF32), tl.trans(weights[LAST]), TF32) + biases[LAST][None, :]
        sample, column = first + tl.arange(0, ROWS), tl.arange(0, PADDED[LAST + 1])
        inside = (sample < stop)[:, None] & (column < SIZES[LAST + 1])[None, :]
        cell = y + (k * S + sample[:, None]) * SIZES[LAST + 1] + column[None, :]
        tl.store(cell, z, mask=inside)


@triton.jit(do_not_specialize=("S", "stretch"))
def _backward(
    x,  # (K, S, O)
    packed,  # (K, P)
    dy,  # (K, S, C)
    parts,  # (K, programs, P), the gradient of each stretch
    x_k,
    x_s,
    P,
    S,
    stretch,
    SIZES: tl.constexpr,
    PADDED: tl.constexpr,
    ROWS: tl.constexpr,
    TF32: tl.constexpr,
):
    """Samples are columns: tensor cores take 64 rows, but registers hold fewer samples."""
    k = tl.program_id(1).to(tl.int64)
    LAST: tl.constexpr = len(SIZES) - 2
    C: tl.constexpr = SIZES[LAST + 1]
    weights, biases = _layers(packed + k * P, SIZES, PADDED)
    by_weight = ()  # the last one transposed, since C may be less than 64
    by_bias = ()
    for i in tl.static_range(LAST):
        by_weight += (tl.full([PADDED[i + 1], PADDED[i]], 0.0, tl.float32),)
        by_bias += (tl.full([PADDED[i + 1]], 0.0, tl.float32),)
    by_weight += (tl.full([PADDED[LAST], PADDED[LAST + 1]], 0.0, tl.float32),)
    by_bias += (tl.full([PADDED[LAST + 1]], 0.0, tl.float32),)
    start = tl.program_id(0) * stretch
    stop = tl.minimum(start + stretch, S)
    for first in tl.range(start, stop, ROWS, num_stages=1):
        seen = _samples(x + k * x_k, first, stop, x_s, SIZES[0], PADDED[0], ROWS)
        slope = _samples(dy + k * S * C, first, stop, C, C, PADDED[LAST + 1], ROWS)
        a = tl.trans(seen)
        zs = ()
        for i in tl.static_range(LAST):
            z = _product(weights[i], _round(a, TF32), TF32) + biases[i][:, None]
            a = z * tl.sigmoid(z)
            zs += (z,)
        sums = (by_weight[LAST] + _product(_round(a, TF32), _round(slope, TF32), TF32),)
        bias_sums = (by_bias[LAST] + tl.sum(slope, 0),)
        d = _product(tl.trans(weights[LAST]), tl.trans(_round(slope, TF32, False)), TF32)
        for i in tl.static_range(LAST - 1, -1, -1):
            s = tl.sigmoid(zs[i])
            d = d * (s + zs[i] * s * (1.0 - s))
            bias_sums = (by_bias[i] + tl.sum(d, 1),) + bias_sums
            d = _round(d, TF32)
            if i > 0:
                below = _product(tl.trans(weights[i]), d, TF32)
                a = tl.trans(_round(zs[i - 1] * tl.sigmoid(zs[i - 1]), TF32, False))
                sums = (by_weight[i] + _product(d, a, TF32),) + sums
                d = below
            else:
                a = _round(seen, TF32, False)
                sums = (by_weight[i] + _product(d, a, TF32),) + sums
        by_weight = sums
        by_bias = bias_sums
    part = parts + (k * tl.num_programs(0) + tl.program_id(0)) * P
    for i in tl.static_range(LAST + 1):
        outputs, inputs = tl.arange(0, PADDED[i + 1]), tl.arange(0, PADDED[i])
        if i < LAST:
            inside = (outputs < SIZES[i + 1])[:, None] & (inputs < SIZES[i])[None, :]
            cell = part + outputs[:, None] * SIZES[i] + inputs[None, :]
        else:
            inside = (inputs < SIZES[i])[:, None] & (outputs < SIZES[i + 1])[None, :]
            cell = part + outputs[None, :] * SIZES[i] + inputs[:, None]
        tl.store(cell, by_weight[i], mask=inside)
        part += SIZES[i + 1] * SIZES[i]
        tl.store(part + outputs, by_bias[i], mask=outputs < SIZES[i + 1])
        part += SIZES[i + 1]


@triton.jit
def _pack(
    parameters,  # the weights and bias of each layer, (K, ...) each
    strides,  # of each, from network to network
    packed,  # (K, P)
    P,
    SIZES: tl.constexpr,
    BLOCK: tl.constexpr,
    TF32: tl.constexpr,
):
    k = tl.program_id(1).to(tl.int64)
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    row = packed + k * P
    for layer in tl.static_range(len(SIZES) - 1):
        inside = i < SIZES[layer + 1] * SIZES[layer]
        weight = tl.load(parameters[2 * layer] + k * strides[2 * layer] + i, mask=inside)
        tl.store(row + i, _round(weight, TF32), mask=inside)
        row += SIZES[layer + 1] * SIZES[layer]
        inside = i < SIZES[layer + 1]
        bias = tl.load(parameters[2 * layer + 1] + k * strides[2 * layer + 1] + i, mask=inside)
        tl.store(row + i, bias, mask=inside)
        row += SIZES[layer + 1]


def run(sizes: tuple[int, ...], parameters: Sequence[Tensor], x: Tensor) -> Tensor:
    """Run K networks, each on its own samples x (K, S, O), to (K, S, C); not differentiable by x.

    The sizes are O, the hidden layers, each with a SiLU, and C. Parameters are the weights
    (K, outputs, inputs) and bias (K, outputs) of each layer in turn, each contiguous within a
    network; or one tensor with all of them in a row, (K, P). x is contiguous in its rows.
    """
    return _FamilyMLP.apply(x, sizes, *parameters)


@cache
def fits(sizes: tuple[int, ...], device: torch.device) -> bool:
    """Return whether the weights and gradients of a network fit on chip. Compiles the kernels."""
    if not INTERPRETED:
        weights = sum(4 * b * a for a, b in pairwise(_padded(sizes)))
        if weights > torch.cuda.get_device_properties(device).shared_memory_per_block_optin:
            return False
    P = sum(shape.numel() for shape in _shapes(sizes))
    zeros = partial(torch.zeros, device=device, dtype=torch.float32)
    try:
        with torch.inference_mode(False), torch.enable_grad():  # rsl_rl acts in inference mode
            parameters = zeros(1, P, requires_grad=True)
            x = zeros(1, FORWARD_ROWS, sizes[0])
            torch.autograd.grad(run(sizes, [parameters], x).sum(), parameters)
    except triton.runtime.errors.OutOfResources:
        return False
    return True


class _FamilyMLP(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, sizes: tuple[int, ...], *parameters: Tensor) -> Tensor:
        K, S, _ = x.shape
        numbers = [shape.numel() for shape in _shapes(sizes)]
        P = sum(numbers)
        packed, y = x.new_empty(K, P), x.new_empty(K, S, sizes[-1])
        rows = min(FORWARD_ROWS, max(SMALLEST, triton.next_power_of_2(S)))
        stretch, number = _stretches(S, PROGRAMS * _processors(x.device) // K, rows)
        ctx.in_one = len(parameters) == 1
        pieces = parameters[0].split(numbers, 1) if ctx.in_one else parameters
        strides = tuple(piece.stride(0) for piece in pieces)
        with torch.cuda.device_of(x):
            _pack[triton.cdiv(max(numbers), BLOCK), K](
                tuple(pieces), strides, packed, P, SIZES=sizes, BLOCK=BLOCK, TF32=not INTERPRETED
            )
            constants = _constants(sizes, rows)
            _forward[number, K](
                x, packed, y, *x.stride()[:2], P, S, stretch, **constants, num_warps=4
            )
        ctx.sizes = sizes
        ctx.save_for_backward(x, packed)
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx, dy: Tensor) -> tuple[Tensor | None, ...]:
        x, packed = ctx.saved_tensors
        (K, S, _), P = x.shape, packed.shape[1]
        # with 8 warps and a layer narrower than 128, Triton 3.6 reads past shared memory
        wide = min(_padded(ctx.sizes)[1:-1]) >= 128
        rows, warps = (32 if S > SMALLEST else SMALLEST, 8) if wide else (SMALLEST, 4)
        stretch, number = _stretches(S, _processors(x.device) // K, rows)
        parts = x.new_empty(K, number, P)
        dy, constants = dy.contiguous(), _constants(ctx.sizes, rows)
        with torch.cuda.device_of(x):
            _backward[number, K](
                x, packed, dy, parts, *x.stride()[:2], P, S, stretch, **constants, num_warps=warps
            )
        gradient = parts.sum(1) if number > 1 else parts[:, 0]
        if ctx.in_one:
            return None, None, gradient
        shapes = _shapes(ctx.sizes)
        pieces = gradient.split([shape.numel() for shape in shapes], 1)
        return None, None, *(g.view(K, *s) for g, s in zip(pieces, shapes, strict=True))


def _shapes(sizes: tuple[int, ...]) -> list[torch.Size]:
    return [torch.Size(shape) for a, b in pairwise(sizes) for shape in ((b, a), (b,))]


def _padded(sizes: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(max(SMALLEST, triton.next_power_of_2(size)) for size in sizes)


def _constants(sizes: tuple[int, ...], rows: int) -> dict[str, Any]:
    return {"SIZES": sizes, "PADDED": _padded(sizes), "ROWS": rows, "TF32": not INTERPRETED}


@cache
def _processors(device: torch.device) -> int:
    return 2 if INTERPRETED else torch.cuda.get_device_properties(device).multi_processor_count


def _stretches(samples: int, most: int, rows: int) -> tuple[int, int]:
    """Cut samples into at most `most` stretches of whole steps: their length and number."""
    number = max(1, min(most, triton.cdiv(samples, rows)))
    length = triton.cdiv(triton.cdiv(samples, number), rows) * rows
    return length, triton.cdiv(samples, length)
