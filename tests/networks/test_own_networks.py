"""Custom networks train, are checked, and are never confused with the config's."""

import copy
from pathlib import Path

import pytest
import torch
from same import assert_same
from tiny import learner as trainer
from tiny import tiny
from torch import nn

from morlax_torch import MORLAX, MorlaxError, Policy, load, save
from morlax_torch.configuration.config import Config
from morlax_torch.runs import checkpoint
from morlax_torch.runs.progress import Progress

O, A, m = 13, 4, 2  # observation size, action size and objectives of the hopper


def usual(**changes: object) -> Config:
    return tiny(**{"network.actor": (64, 64), **changes})


def weights(morlax: MORLAX) -> dict[str, torch.Tensor]:
    return morlax.state_dict()["agent"]


def normed(inputs: int = O, outputs: int = 2 * A) -> nn.Module:
    torch.manual_seed(3)
    return nn.Sequential(nn.Linear(inputs, 16), nn.LayerNorm(16), nn.ELU(), nn.Linear(16, outputs))


def tanh() -> nn.Module:
    """Make an actor whose parameters have the names and shapes of the config's actor."""
    torch.manual_seed(3)
    layers = nn.Linear(O, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 2 * A)
    return nn.Sequential(*layers)


@pytest.mark.parametrize("type", ("dual", "single"))
def test_custom_networks_train(type):
    config = usual(network={"type": type})
    networks = {"actor": normed(), "critic": normed(outputs=m)}
    kept = copy.deepcopy(networks)
    before = weights(trainer(config, 0, **networks))
    morlax = trainer(config, 3, **networks)
    after = weights(morlax)
    for part in ("actor", "critic"):
        assert not torch.equal(before[f"{part}.bias"], after[f"{part}.bias"])
        assert_same(networks[part].state_dict(), kept[part].state_dict())
    assert all(value == value for value in morlax.metrics().values())
    assert_same(weights(trainer(config, 3, **networks)), after)


def halved() -> nn.Module:
    """Return a network with a tensor that was computed, as the former weight_norm leaves one."""
    layer = nn.Linear(O, 2 * A)
    layer.half = layer.weight / 2
    return layer


MISFITS = {
    r"the actor maps observations \(2, 13\) to \(2, 4\), but it should return \(2, 8\)": {
        "actor": nn.Linear(O, A)
    },
    r"the actor cannot take observations \(2, 13\): .*13.*17": {"actor": nn.Linear(17, 2 * A)},
    "the actor has no parameters": {"actor": nn.Identity()},
    "it draws random numbers": {"actor": nn.Sequential(nn.Linear(O, 2 * A), nn.Dropout())},
    r"the actor has parameters of torch\.float64, .*: use \.float\(\)": {
        "actor": nn.Linear(O, 2 * A, dtype=torch.float64)
    },
    "the actor cannot be copied: RuntimeError: Only Tensors created": {"actor": halved()},
}


class Stateful(nn.Linear):
    """A network that keeps state between calls, in one of several ways."""

    def __init__(self, inputs: int, outputs: int, way: str):
        super().__init__(inputs, outputs)
        self.register_buffer("state", torch.zeros(outputs))
        self.way, self.history = way, []

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = super().forward(x)
        if self.way == "assigned":
            self.state = self.state + y.mean(0).detach()
        elif self.way == "list":
            self.history.append(y)
        return y


@pytest.mark.parametrize("algorithm", ["morlax", "amor"])
@pytest.mark.parametrize("way", ["assigned", "list"])
def test_networks_that_keep_state_between_calls_are_refused(way, algorithm):
    inputs = O + (m if algorithm == "amor" else 0)
    actor, critic = Stateful(inputs, 2 * A, way), Stateful(inputs, m, way)
    for name, network in (("actor", actor), ("critic", critic)):
        with pytest.raises(
            MorlaxError, match=f"the {name} keeps tensors from call to call"
        ) as error:
            trainer(usual(algorithm=algorithm), **{name: network})
        assert "\n" not in str(error.value)
        copy.deepcopy(network)  # it is as before
        assert not network.history and not network.state.any()
    actor.way = ""
    trainer(usual(algorithm=algorithm), actor=actor)


@pytest.mark.parametrize("sentence", MISFITS)
def test_a_network_that_does_not_fit_raises_a_clear_error(sentence):
    with pytest.raises(MorlaxError, match=sentence) as error:
        trainer(usual(), **MISFITS[sentence])
    assert "\n" not in str(error.value)


@pytest.fixture
def saved(tmp_path: Path) -> tuple[Path, MORLAX]:
    morlax = trainer(usual(), 2, actor=tanh())
    checkpoint.write(tmp_path / "own.pt", checkpoint.snapshot(morlax), Progress())
    return tmp_path / "own.pt", morlax


def test_a_loaded_policy_with_a_custom_actor_gives_the_same_actions(saved, generator, tmp_path):
    path, morlax = saved
    observation = torch.randn(5, O, generator=generator)
    before = Policy(morlax.agent, morlax.config, morlax.env.objectives)
    after = load(path, actor=tanh())
    save(after, tmp_path / "alone.pt")
    alone = load(tmp_path / "alone.pt", actor=tanh())
    for tradeoff in ((1.0, 0.0), (0.3, 0.7)):
        expected = before(observation, tradeoff)
        assert torch.equal(after(observation, tradeoff), expected)
        assert torch.equal(alone(observation, tradeoff), expected)
        torch.testing.assert_close(after.specialize(tradeoff)(observation), expected)


def test_a_custom_actor_is_never_confused_with_the_config_s(saved, tmp_path):
    path, _ = saved  # same shapes as the config's actor; only the tanh differs
    words = "user-made actor, which no config describes: .* pass a module like it, actor="
    with pytest.raises(MorlaxError, match=words):
        load(path)
    save(load(path, actor=tanh()), tmp_path / "alone.pt")
    with pytest.raises(MorlaxError, match=words):
        load(tmp_path / "alone.pt")
    with pytest.raises(MorlaxError, match=words):
        checkpoint.restore(checkpoint.load(path), path, trainer(usual(), 0))
    with pytest.raises(MorlaxError, match=r"the actor passed does not match the one in .*own\.pt"):
        load(path, actor=normed())
    checkpoint.write(tmp_path / "usual.pt", checkpoint.snapshot(trainer(usual(), 0)), Progress())
    with pytest.raises(MorlaxError, match="the stored ones are of its config"):
        load(tmp_path / "usual.pt", actor=tanh())


def test_a_custom_critic_is_needed_to_resume_but_not_to_act(tmp_path, generator):
    path, critic = tmp_path / "own.pt", normed(outputs=m)
    morlax = trainer(usual(), 2, critic=critic)
    checkpoint.write(path, checkpoint.snapshot(morlax), Progress())
    observation = torch.randn(5, O, generator=generator)
    expected = Policy(morlax.agent, morlax.config, ("run", "jump"))(observation, (0.5, 0.5))
    assert torch.equal(load(path)(observation, (0.5, 0.5)), expected)
    save(load(path), tmp_path / "alone.pt")
    assert torch.equal(load(tmp_path / "alone.pt")(observation, (0.5, 0.5)), expected)
    with pytest.raises(MorlaxError, match="user-made critic, which no config describes"):
        checkpoint.restore(checkpoint.load(path), path, trainer(usual(), 0))
    resumed = trainer(usual(), 0, critic=critic)
    checkpoint.restore(checkpoint.load(path), path, resumed)
    assert_same(weights(resumed), weights(morlax))
