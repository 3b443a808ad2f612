"""Several processes that train one agent together, one per GPU."""

import time
from collections.abc import Callable
from datetime import timedelta
from functools import cache, cached_property
from typing import Any, TypeVar
from uuid import uuid4

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.distributed import Store
from torch.distributed.rendezvous import rendezvous

from ..envs import MorlaxError, resolve_device
from ..host.torchrun import LOCAL_RANK, PROCESSES, SEVERAL

T = TypeVar("T")

PATIENCE = timedelta(seconds=60)  # to meet, and between collectives of iterations
BUSY = timedelta(minutes=30)  # for one that films or writes an evaluation, while others wait
PAUSE = 0.02  # s


def _together(collective: Callable[..., Any], *arguments: Any, group: Any) -> None:
    """Run a collective and tell a user why it fails: gloo and NCCL only name a socket."""
    try:
        collective(*arguments, group=group)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise MorlaxError(
            f"another process of this run has ended or does not answer ({reason})."
        ) from None


class Group:
    """The processes of a run, started by `torchrun`. Alone, every method changes nothing.

    Collectives run in the same order in every process. On CUDA they are recorded in graphs, like
    other GPU work; work in parallel branches needs the `channel`. One process group is for
    tensors, one for objects on the CPU.
    """

    rank: int = 0
    size: int = 1

    def __init__(self, tensors: Any = None, objects: Any = None):
        self._tensors, self._objects = tensors, objects
        if tensors is not None:
            self.rank, self.size = dist.get_rank(), dist.get_world_size()

    @cached_property
    def channel(self) -> "Group":
        """The same processes, for collectives in parallel with those of this group."""
        if self.size == 1:
            return self
        backend = dist.get_backend(self._tensors)
        return Group(dist.new_group(backend=backend, timeout=PATIENCE), self._objects)

    def mean_(self, x: Tensor) -> Tensor:
        """Average a tensor over the processes, in place."""
        if self.size > 1:
            _together(dist.all_reduce, x, group=self._tensors)
            x.div_(self.size)
        return x

    def largest_(self, x: Tensor) -> Tensor:
        """Take the maximum of a tensor over the processes, in place."""
        if self.size > 1:
            _together(dist.all_reduce, x, dist.ReduceOp.MAX, group=self._tensors)
        return x

    def moments(self, mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and biased variance of the samples of all processes, each of as many."""
        if self.size == 1:
            return mean, variance
        # double, because the mean of the squares may be far larger than the variance
        square = variance.double() + mean.double().square()
        both = self.mean_(torch.stack([mean.double(), square]))
        return both[0].to(mean), (both[1] - both[0].square()).clamp(min=0).to(variance)

    def first(self, value: T) -> T:
        """Return the first process's value, a number or another object on the CPU."""
        values = [value]
        if self.size > 1:
            _together(dist.broadcast_object_list, values, 0, group=self._objects)
        return values[0]

    def gather(self, value: T) -> list[T]:
        """Return every process's value, in the order of ranks."""
        values: list[Any] = [value] * self.size
        if self.size > 1:
            _together(dist.all_gather_object, values, value, group=self._objects)
        return values

    def share(self, module: nn.Module) -> None:
        """Copy the first process's parameters and buffers into `module`, in place."""
        tensors = [x.detach() for x in (*module.parameters(), *module.buffers())]
        rank = self.unlike_first([x.shape for x in tensors])
        if rank:
            raise MorlaxError(
                f"process {rank} has networks of other sizes than process 0: give every process "
                "the same actor, critic and task."
            )
        if self.size > 1:
            firsts = self.first([x.cpu() for x in tensors])
            for x, first in zip(tensors, firsts, strict=True):
                x.copy_(first)

    def unlike_first(self, value: Any) -> int:
        """Return the lowest rank of a process with another value than the first one, else 0."""
        values = self.gather(value)
        return next((rank for rank, other in enumerate(values) if other != values[0]), 0)


ALONE = Group()


def join(device: str | None, settings: str) -> tuple[str | None, Group]:
    """Join the processes that `torchrun` started, if it did, each on a GPU of its own.

    It may be called again for another run of the same processes, or after
    `torch.distributed.init_process_group`. It returns the device of this process, and the group.

    Raises:
        MorlaxError: not all of them came within a minute, there are fewer GPUs, or they have
            different settings.
    """
    if not SEVERAL:
        return device, ALONE
    local = resolve_device(device)
    if local.type == "cuda":
        local = resolve_device(f"cuda:{LOCAL_RANK}")
        torch.cuda.set_device(local)
    try:
        group = _processes("nccl" if local.type == "cuda" else "gloo")
    except (OSError, RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise MorlaxError(
            f"the {PROCESSES} processes of this run did not find each other: {reason}"
        ) from None
    if rank := group.unlike_first(settings):
        raise MorlaxError(
            f"process {rank} has another config than process 0: start all processes with the same "
            "command."
        )
    return str(local), group


@cache
def _processes(backend: str) -> Group:
    """Return all processes, once they have met."""
    if not dist.is_initialized():
        store, rank, size = next(rendezvous("env://", timeout=PATIENCE))
        store.set_timeout(PATIENCE)
        store = dist.PrefixStore(meet(store, rank, size, PATIENCE.total_seconds()), store)
        dist.init_process_group(backend, store=store, rank=rank, world_size=size, timeout=PATIENCE)
    objects = dist.new_group(backend="gloo", timeout=BUSY)
    return Group(dist.group.WORLD, objects)


def meet(store: Store, rank: int, size: int, seconds: float) -> str:
    """Wait for all processes, and return a name that no other meeting in this store has.

    torchrun keeps its store over restarts, with the addresses of processes that have ended, and
    its launchers on several hosts do not count each other's restarts. So each process shows a new
    word, which the first one answers. The first one waits so many seconds, and then raises
    TimeoutError; others wait for the store's timeout, a RuntimeError.
    """
    word = uuid4().hex
    store.set(f"word/{rank}", word)
    if rank > 0:
        name = store.get(f"answer/{word}").decode()
        store.set(f"met/{name}/{rank}", "")
        return name
    missing, end = set(range(1, size)), time.monotonic() + seconds
    while missing:
        for other in tuple(missing):
            if store.check([f"word/{other}"]):  # perhaps of a process that has ended
                store.set(f"answer/{store.get(f'word/{other}').decode()}", word)
            if store.check([f"met/{word}/{other}"]):
                missing.remove(other)
        if time.monotonic() >= end:
            raise TimeoutError(f"process {min(missing)} did not come within {seconds:g} s")
        time.sleep(PAUSE)
    return word
