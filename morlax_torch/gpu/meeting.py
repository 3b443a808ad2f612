"""How the processes of a run meet in a store, which may be older than they are."""

import time
from uuid import uuid4

from torch.distributed import Store

PAUSE = 0.02  # s


def meet(store: Store, rank: int, size: int, seconds: float) -> str:
    """Wait for all processes, and return a name that no other meeting in this store has.

    torchrun keeps its store over restarts, with the addresses of processes that have ended, and
    its launchers on several hosts do not count each other's restarts. So each process shows a new
    word, which the first one answers.

    Args:
        store: the store of all processes.
        rank: the number of this process.
        size: the number of processes.
        seconds: for how long the first process waits; others wait for the store's timeout.

    Raises:
        RuntimeError: the first process did not come.
        TimeoutError: another process did not come.
    """
    own = uuid4().hex
    store.set(f"word/{rank}", own)
    if rank > 0:
        name = store.get(f"answer/{own}").decode()
        store.set(f"met/{name}/{rank}", "")
        return name
    missing, end = set(range(1, size)), time.monotonic() + seconds
    while missing:
        for other in tuple(missing):
            if store.check([f"word/{other}"]):  # perhaps of a process that has ended
                store.set(f"answer/{store.get(f'word/{other}').decode()}", own)
            if store.check([f"met/{own}/{other}"]):
                missing.remove(other)
        if time.monotonic() >= end:
            raise TimeoutError(f"process {min(missing)} did not come within {seconds:g} s")
        time.sleep(PAUSE)
    return own
