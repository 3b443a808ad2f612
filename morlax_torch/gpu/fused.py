"""Where Triton's kernels may take the place of their torch definitions."""

import warnings
from collections.abc import Sequence
from functools import cache

import torch
from torch import Tensor

FEWEST_ROWS = 16  # samples per network, below which a batched product is as fast
MOST_NETWORKS = 64  # above it, the affine map is a product large enough for cuBLAS


@cache
def available(device: torch.device) -> bool:
    """Return whether Triton's kernels run on this device; on CUDA, warn once if they do not."""
    if device.type != "cuda":
        return False
    try:
        from . import mlp_kernels

        with torch.cuda.device(device):
            if mlp_kernels.fits((1, 1, 1), device):
                return True
        reason = "they do not fit on this GPU"
    except Exception as error:  # without a compiler, or on an old GPU, Triton raises many kinds
        reason = (str(error) or repr(error)).splitlines()[0]
    warnings.warn(
        f"training without fused kernels, which is slower: Triton cannot run them ({reason}). "
        "`pip install triton` installs it; it needs Linux, a C compiler and a GPU of compute "
        "capability 8.0 or newer.",
        stacklevel=2,
    )
    return False


def mlps(sizes: tuple[int, ...], parameters: Sequence[Tensor], x: Tensor) -> Tensor | None:
    """Run K MLPs on x (K, S, O) with `mlp_kernels.run`; None where that cannot or should not be."""
    if not (
        x.is_cuda
        and x.dim() == 3
        and x.dtype == torch.float32
        and x.stride(2) == 1
        and not x.requires_grad
        and (len(x) == 1 or x.shape[1] >= FEWEST_ROWS)
        and all(p.dtype == x.dtype and p[0].is_contiguous() for p in parameters)
        and torch.get_float32_matmul_precision() != "highest"  # they round to TF32
        and _alone()
        and available(x.device)
    ):
        return None
    from . import mlp_kernels

    if not mlp_kernels.fits(sizes, x.device):
        return None
    whole = _whole(parameters)
    return mlp_kernels.run(sizes, parameters if whole is None else [whole], x)


def _whole(parameters: Sequence[Tensor]) -> Tensor | None:
    """Return the tensor (K, P) that a family's parameters are consecutive columns of, if any.

    Its gradient then needs no kernel to put the pieces together.
    """
    whole = parameters[0]._base
    if whole is None or whole.dim() != 2 or not whole.is_contiguous():
        return None
    start = whole.storage_offset()
    for parameter in parameters:
        mine = parameter._base is whole and parameter.storage_offset() == start
        if not mine or (len(parameter), parameter.stride(0)) != whole.shape:
            return None
        start += parameter[0].numel()
    return whole if start == whole.storage_offset() + whole.shape[1] else None


def affine(features: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Return features (K, F) @ weight (P, F).T + bias (P,)."""
    if (
        features.is_cuda
        and len(features) <= MOST_NETWORKS
        and features.dtype == weight.dtype == torch.float32
        and _alone()
        and available(features.device)
    ):
        from . import affine_kernels

        return affine_kernels.affine(features, weight, bias)
    return torch.addmm(bias, features, weight.t())


def copy(*pairs: tuple[Tensor, Tensor]) -> None:
    """Copy into the first of each pair, which is contiguous, from the second, of the same dtype."""
    targets = [target for target, _ in pairs]
    sources = [source.view_as(target) for target, source in pairs]
    if available(targets[0].device):
        from . import adam_kernels

        adam_kernels.copy(targets, sources)
    else:
        for target, source in zip(targets, sources, strict=True):
            target.copy_(source)


def _alone() -> bool:
    """Return whether no tracer, compiler or transform of torch.func is at work."""
    return not (
        torch.jit.is_tracing()
        or torch.compiler.is_compiling()
        or torch._C._are_functorch_transforms_active()
    )
