"""Training starts with the policies of another run, which may have fewer objectives."""

from collections.abc import Mapping
from pathlib import Path

import pytest
import torch
from numpy.testing import assert_allclose
from same import assert_same
from tiny import learner, tiny

import morlax_torch
from morlax_torch import MorlaxError
from morlax_torch.runs import checkpoint
from morlax_torch.runs.loading import start_from
from morlax_torch.train import train

THREE = {"run": {"run": 1.0}, "energy": {"energy": 1.0}, "tall": {"height": 2.0}}


@pytest.fixture(scope="module")
def base(tmp_path_factory) -> Path:
    """Return a short run of two objectives."""
    return train(tiny("cheetah"), output=tmp_path_factory.mktemp("runs") / "base").folder


def started(base: Path, **changes):
    config = tiny("cheetah", start_from=str(base), **changes)
    made = learner(config)
    start_from(str(base), made)
    return made


def test_the_policies_of_known_objectives_stay(base, tmp_path):
    old = morlax_torch.load(base)
    torch.nn.init.normal_(old.agent.actor.weight, std=0.1)  # trade-offs then differ
    (tmp_path / "other" / "checkpoints").mkdir(parents=True)
    morlax_torch.save(old, tmp_path / "other" / "checkpoints" / "best.pt")
    agent = started(tmp_path / "other", task={"objectives": THREE}).agent
    observation = torch.randn(5, 17, generator=torch.Generator().manual_seed(0))
    for three, two in (
        ((0.3, 0.7, 0.0), (0.3, 0.7)),
        ((1.0, 0.0, 0.0), (1.0, 0.0)),
        ((0.0, 0.0, 1.0), (0.5, 0.5)),
        ((0.5, 0.0, 0.5), (0.75, 0.25)),
    ):
        found = agent.actors(torch.tensor([three])).act(observation[None])[0]
        assert_allclose(found.detach(), old(observation, two), rtol=1e-4, atol=1e-5)


def test_objectives_may_be_in_another_order_and_the_critic_stays_if_they_do(base):
    def critic(state: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        return {n: v for n, v in state.items() if n.startswith(("critic.", "value_normalizer."))}

    swapped = {"energy": {"energy": 1.0}, "run": {"run": 1.0}}
    path = base / "checkpoints" / "latest.pt"
    trained, kept = checkpoint.load(path).agent, started(path)
    fresh = started(path, task={"objectives": swapped})
    assert_same(critic(kept.agent.state_dict()), critic(trained))
    assert (fresh.agent.critic.weight != trained["critic.weight"]).any()
    observation = torch.ones(1, 17)
    found = fresh.agent.actors(torch.tensor([[0.2, 0.8]])).act(observation[None])[0]
    expected = morlax_torch.load(path)(observation, (0.8, 0.2))
    assert_allclose(found.detach(), expected, rtol=1e-4, atol=1e-5)


STARTS = {
    "sizes": ({"network.actor": [8, 8]}, "have other sizes than this run's"),
    "algorithm": ({"algorithm": "amor"}, "start_from needs hypernetworks"),
}


@pytest.mark.parametrize(("changes", "message"), STARTS.values(), ids=STARTS)
def test_policies_that_do_not_fit_are_one_sentence(changes, message, base):
    with pytest.raises(MorlaxError, match=message):
        started(base, **changes)
