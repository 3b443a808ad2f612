"""Choose Triton kernels or their torch definitions."""

import warnings
from collections.abc import Callable, Sequence
from functools import cache

import torch
from torch import Tensor, nn

from ..envs.replacing import P, R
from ..envs.replacing import kernel as choice

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


def kernel(
    twin: str, when: Callable[..., bool] = lambda *_: True
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Let a Triton kernel replace the torch definition that is decorated.

    Args:
        twin: "module.function" of this package, of the same parameters.
        when: tells from the arguments whether the kernel can and should run where Triton does.
    """

    def suits(*arguments) -> bool:
        first = arguments[0] if isinstance(arguments[0], Tensor) else arguments[0][0]
        return when(*arguments) and available(first.device)

    return choice(f"{__package__}.{twin}", suits)


def _suits_mlps(x: Tensor, sizes: tuple[int, ...], parameters: Sequence[Tensor], *_) -> bool:
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
        return False
    from . import mlp_kernels

    return mlp_kernels.fits(sizes, x.device)


@kernel("fused.run_mlps", _suits_mlps)
def mlps(
    x: Tensor,
    sizes: tuple[int, ...],
    parameters: Sequence[Tensor],
    definition: Callable[[], Tensor],
) -> Tensor:
    """Run K MLPs with these parameters (K, ...) on x (K, S, O), as `definition` does."""
    return definition()


def run_mlps(x: Tensor, sizes: tuple[int, ...], parameters: Sequence[Tensor], *_) -> Tensor:
    """`mlps` with Triton."""
    from . import mlp_kernels

    whole = _whole(parameters)
    return mlp_kernels.run(sizes, parameters if whole is None else [whole], x)


def _suits_mlp(x: Tensor, sizes: tuple[int, ...] | None, network: nn.Module) -> bool:
    return sizes is not None and _suits_mlps(x[None], sizes, _as_family(network))


@kernel("fused.run_mlp", _suits_mlp)
def mlp(x: Tensor, sizes: tuple[int, ...] | None, network: nn.Module) -> Tensor:
    """Run a network on x (S, O); `sizes` are None if it is no MLP."""
    return network(x)


def run_mlp(x: Tensor, sizes: tuple[int, ...], network: nn.Module) -> Tensor:
    """`mlp` with Triton."""
    return run_mlps(x[None], sizes, _as_family(network)).squeeze(0)


def _as_family(network: nn.Module) -> list[Tensor]:
    return [value[None] for value in network.parameters()]


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


def _suits_affine(features: Tensor, weight: Tensor, _: Tensor) -> bool:
    few = features.is_cuda and len(features) <= MOST_NETWORKS
    return few and features.dtype == weight.dtype == torch.float32 and _alone()


@kernel("affine_kernels.affine", _suits_affine)
def affine(features: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Return features (K, F) @ weight (P, F).T + bias (P,)."""
    return torch.addmm(bias, features, weight.t())


def _alone() -> bool:
    """Return whether no tracer, compiler or transform of torch.func is at work."""
    return not (
        torch.jit.is_tracing()
        or torch.compiler.is_compiling()
        or torch._C._are_functorch_transforms_active()
    )
