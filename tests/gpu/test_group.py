"""Several processes meet, and train one agent."""

from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta

import pytest
import torch
import two_processes
from programs import ended, start_both
from same import assert_same
from torch.distributed import HashStore, PrefixStore, Store
from torch.testing import assert_close

from morlax_torch.algorithms.registry import LEARNERS
from morlax_torch.envs.devices import seed_of
from morlax_torch.gpu.group import ALONE, meet


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> list[dict]:
    folder = tmp_path_factory.mktemp("processes")
    code = "import sys, two_processes; two_processes.main(*sys.argv[1:])"
    statuses, _, errors = ended(start_both(code, folder, (str(folder), *LEARNERS)), 300)
    assert statuses == [0, 0], errors
    return [torch.load(folder / f"{rank}.pt") for rank in range(2)]


@pytest.mark.parametrize("algorithm", LEARNERS)
@pytest.mark.slow
def test_all_processes_have_the_same_agent_from_worlds_of_their_own(found, algorithm):
    one, other = (process[algorithm] for process in found)
    for part in ("agent", "optimizers", "metrics"):
        assert_same(one[part], other[part])
    steps = two_processes.ITERATIONS * two_processes.WORLDS * two_processes.HORIZON
    assert one["steps"] == steps
    assert not torch.equal(one["observation"], other["observation"])
    assert not torch.equal(one["generator"], other["generator"])


@pytest.mark.parametrize("algorithm", LEARNERS)
@pytest.mark.slow
def test_all_processes_train_the_first_one_s_own_networks(found, algorithm):
    one, other = (process["own"][algorithm] for process in found)
    assert_same(one["agent"], other["agent"])
    assert_same(one["optimizers"], other["optimizers"])
    (buffer,) = {"actor.target_buffer_0", "actor.network.shift"} & one["agent"].keys()
    assert torch.equal(one["agent"][buffer], one["shift"])


@pytest.mark.slow
def test_all_processes_start_from_the_first_one_s_checkpoint_and_sizes(found):
    assert_same(found[0]["started"], found[1]["started"])
    for process in found:
        assert "process 1 has networks of other sizes than process 0" in process["refusal"]


@pytest.mark.slow
def test_statistics_of_two_processes_are_those_of_one_with_all_worlds(found):
    whole, halves = two_processes.statistics(ALONE), [one["statistics"] for one in found]
    for half in halves:
        for normalizer in ("observation", "value"):
            for name, value in whole[normalizer].items():
                assert_close(half[normalizer][name], value, rtol=1e-6, atol=1e-6)
    together = torch.stack([half["advantage"] for half in halves], 2).flatten(1, 2)
    assert_close(together, whole["advantage"], rtol=1e-5, atol=1e-6)


def test_processes_have_their_own_seeds():
    seeds = {seed_of(seed, rank) for seed in range(20) for rank in range(20)}
    assert len(seeds) == 400 and max(seeds) < 2**63
    assert [seed_of(seed, 0) for seed in range(3)] == [0, 1, 2]


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
