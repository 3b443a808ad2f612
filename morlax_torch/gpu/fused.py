"""Choose Triton kernels or their torch definitions."""

import warnings
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor, nn

FEWEST_ROWS = 16  # samples per network, below which a batched product is as fast


class Kernels(NamedTuple):
    """Triton's version of each torch definition that has one, of the same parameters."""

    step: Callable[..., None]  # `gpu.optimizer.step`
    sample: Callable[..., tuple[Tensor, Tensor]]  # `networks.gaussian.sample`, without gradients
    policy_loss: Callable[..., tuple[Tensor, Tensor]]  # `algorithms.ppo.policy_loss`


@cache
def kernels(device: torch.device) -> Kernels | None:
    """Return Triton's kernels if they run on this device; on CUDA, warn once if they do not."""
    if device.type != "cuda":
        return None
    try:
        from . import adam_kernels, mlp_kernels, policy_kernels

        with torch.cuda.device(device):
            if mlp_kernels.fits((1, 1, 1), device):
                return Kernels(adam_kernels.step, policy_kernels.sample, policy_kernels.policy_loss)
        reason = "they do not fit on this GPU"
    except Exception as error:  # without a compiler, or on an old GPU, Triton raises many kinds
        reason = (str(error) or repr(error)).splitlines()[0]
    warnings.warn(
        f"training without fused kernels, which is slower: Triton cannot run them ({reason}). "
        "`pip install triton` installs it; it needs Linux, a C compiler and a GPU of compute "
        "capability 8.0 or newer.",
        stacklevel=2,
    )
    return None


def mlps(
    x: Tensor,
    sizes: tuple[int, ...],
    parameters: Sequence[Tensor],
    definition: Callable[[], Tensor],
) -> Tensor:
    """Run K MLPs on x (K, S, O), as `definition` does; `mlp_kernels.run` has the parameters."""
    if not _suits(x, parameters):
        return definition()
    from . import mlp_kernels

    if not mlp_kernels.fits(sizes, x.device):
        return definition()
    table = _table(parameters)
    return mlp_kernels.run(sizes, parameters if table is None else [table], x)


def mlp(x: Tensor, sizes: tuple[int, ...] | None, network: nn.Module) -> Tensor:
    """Run a network on x (S, O); `sizes` are None if it is no MLP."""
    if sizes is None or not x.is_cuda:
        return network(x)
    parameters = [value[None] for value in network.parameters()]
    return mlps(x[None], sizes, parameters, lambda: network(x)[None]).squeeze(0)


def _suits(x: Tensor, parameters: Sequence[Tensor]) -> bool:
    """Return whether the kernels can and should run these networks."""
    return (
        x.is_cuda
        and x.dim() == 3
        and x.dtype == torch.float32
        and x.stride(2) == 1
        and not x.requires_grad
        and (len(x) == 1 or x.shape[1] >= FEWEST_ROWS)
        and all(p.dtype == x.dtype and p[0].is_contiguous() for p in parameters)
        and torch.backends.cuda.matmul.fp32_precision == "tf32"  # which they round to
        and not (  # a tracer, compiler or transform of torch.func is at work
            torch.jit.is_tracing()
            or torch.compiler.is_compiling()
            or torch._C._are_functorch_transforms_active()
        )
        and kernels(x.device) is not None
    )


def _table(parameters: Sequence[Tensor]) -> Tensor | None:
    """Return the tensor (K, P) that a family's parameters are consecutive columns of, if any.

    Its gradient then needs no kernel to put the pieces together.
    """
    table = parameters[0]._base
    if table is None or table.dim() != 2 or not table.is_contiguous():
        return None
    start = table.storage_offset()
    for parameter in parameters:
        inside = parameter._base is table and parameter.storage_offset() == start
        if not inside or (len(parameter), parameter.stride(0)) != table.shape:
            return None
        start += parameter[0].numel()
    return table if start == table.storage_offset() + table.shape[1] else None
