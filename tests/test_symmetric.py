"""Policies of robots whose left and right are alike."""

import pytest
import torch
from tiny import Blind, learner, tiny

from morlax_torch import MorlaxError, Policy, envs, load, save
from morlax_torch.envs.worlds.mirror import Mirror, Reflection
from morlax_torch.exports.exporting import export

SEEN = Reflection.of([1, 0, 2, 4, 3, 5, 6, 7, 9, 8, 10, 11, 12], [1, 1, -1, -1, -1, 1] * 2 + [1])
ACTED = Reflection.of([0, 2, 1, 3], [-1.0, 1.0, 1.0, 1.0])


class Mirrored(Blind):
    """A hopper, as if it had a left and a right."""

    def mirror(self) -> Mirror:
        return Mirror(SEEN, ACTED)


@pytest.fixture(autouse=True)
def tasks(monkeypatch):
    monkeypatch.setattr(envs.registry, "_REGISTRY", dict(envs.registry._REGISTRY))
    envs.register("mirrored", Mirrored)


@pytest.mark.parametrize("network", ["dual", "single", "conditioned", "independent"])
def test_mirrored_observations_give_mirrored_actions_and_equal_values(tmp_path, network, generator):
    changes = {"network.symmetric": True, "network.type": network, "task.reset_noise": 0.01}
    algorithm = {"conditioned": "amor", "independent": "independent"}.get(network, "morlax")
    morlax = learner(tiny("mirrored", algorithm=algorithm, **changes), iterations=3)
    raw = 3 * torch.randn(4, 5, 13, generator=generator)
    tradeoffs = torch.rand(4, 2, generator=generator)
    normalizer, size = morlax.agent.observation_normalizer, morlax.env.observation_size
    values = morlax.agent.values(tradeoffs)
    torch.testing.assert_close(values(normalizer(SEEN(raw))), values(normalizer(raw)))
    actors, seen = morlax.agent.actors(tradeoffs), SEEN.first(size)
    mirrored, plain = (actors.distribution(x[..., :size]) for x in (SEEN(raw), raw))
    torch.testing.assert_close(mirrored.std, plain.std[..., ACTED.order])
    torch.testing.assert_close(mirrored.mode, ACTED(plain.mode))
    assert not torch.allclose(plain.mode, actors.act(seen(raw[..., :size])), atol=1e-4)

    policy = Policy(morlax.agent, morlax.config, morlax.env.objectives)
    save(policy, tmp_path / "policy.pt")
    loaded, x = load(tmp_path / "policy.pt"), raw[0, :, :size]
    torch.testing.assert_close(loaded(seen(x), (0.3, 0.7)), ACTED(policy(x, (0.3, 0.7))))


@pytest.mark.parametrize(("format", "tradeoff"), [("torchscript", (0.5, 0.5)), ("onnx", None)])
def test_symmetric_policies_can_be_exported(tmp_path, format, tradeoff):
    morlax = learner(tiny("mirrored", **{"network.symmetric": True}), iterations=2)
    policy = Policy(morlax.agent, morlax.config, morlax.env.objectives)
    assert export(policy, tmp_path / "policy", format, tradeoff) < 1e-5


def test_worlds_that_know_no_mirror_are_refused():
    with pytest.raises(MorlaxError, match=r"network\.symmetric needs worlds that know left from"):
        learner(tiny("hopper", **{"network.symmetric": True}))
