"""Processes meet in a store that others may have used before them."""

from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta

import pytest
from torch.distributed import HashStore, PrefixStore, Store

from morlax_torch.gpu.group import meet


def met(store: Store, size: int) -> set[str]:
    """Let processes meet, and return the names that they agree on."""
    with ThreadPoolExecutor(size) as pool:
        names = pool.map(lambda rank: meet(store, rank, size, 20.0), reversed(range(size)))
        return set(names)


@pytest.fixture
def store() -> Store:
    store = HashStore()
    store.set_timeout(timedelta(seconds=20))
    return PrefixStore("run", store)


def test_all_processes_get_one_name_and_every_meeting_another(store):
    names = [met(store, 3) for _ in range(5)]
    assert all(len(name) == 1 for name in names)
    assert len(set.union(*names)) == 5


def test_words_of_processes_that_ended_while_they_met_are_no_harm(store):
    store.set_timeout(timedelta(seconds=0.1))
    for rank in (1, 2):
        with pytest.raises(RuntimeError):  # process 0 has not come yet
            meet(store, rank, 3, 20.0)
    with pytest.raises(TimeoutError, match=r"process 1 did not come within 0\.1 s"):
        meet(store, 0, 3, 0.1)
    store.set_timeout(timedelta(seconds=20))
    assert len(met(store, 3)) == 1
