"""Policies of robots whose left and right are alike."""

import pytest
import torch
from tiny import Blind, learner, tiny

from morlax_torch import MorlaxError, Policy, envs, load, save
from morlax_torch.algorithms.registry import LEARNERS, make_learner
from morlax_torch.envs import Worlds
from morlax_torch.envs.worlds.mirror import Mirror, Reflection
from morlax_torch.exports.exporting import export
from morlax_torch.networks.hypernetwork import Hypernetwork
from morlax_torch.networks.mlp import mlp
from morlax_torch.networks.symmetric import Symmetric
from morlax_torch.runs.training import make_worlds

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


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_every_algorithm_trains_symmetric_policies(algorithm, generator):
    own = {
        "hyper-sac": {"method.start": 32, "method.batch": 8, "method.updates": 2},
        "pd-morl": {"method.start": 32, "method.batch": 8, "method.updates": 2},
        "pg-morl": {"method.warmup": 1, "method.generation": 1},
    }
    changes = {"network.symmetric": True, "task.reset_noise": 0.3, **own.get(algorithm, {})}
    config = tiny("mirrored", algorithm=algorithm, **changes)
    learner = make_learner(make_worlds(config, config.worlds), config)
    for iteration in range(3):
        learner.iterate(iteration / 3)
    policy = Policy(learner.agent, config, learner.env.objectives)
    size = learner.env.observation_size
    x, seen = torch.randn(16, size, generator=generator), SEEN.first(size)
    assert learner.agent.observation_normalizer.mean.any()
    torch.testing.assert_close(policy(seen(x), (0.3, 0.7)), ACTED(policy(x, (0.3, 0.7))))


@pytest.mark.parametrize(("format", "tradeoff"), [("torchscript", (0.5, 0.5)), ("onnx", None)])
def test_symmetric_policies_can_be_exported(tmp_path, format, tradeoff):
    morlax = learner(tiny("mirrored", **{"network.symmetric": True}), iterations=2)
    policy = Policy(morlax.agent, morlax.config, morlax.env.objectives)
    assert export(policy, tmp_path / "policy", format, tradeoff) < 1e-5


def test_asymmetry_leads_from_symmetric_networks_to_plain_ones(generator):
    plain = mlp(13, (8,), 8, generator)
    reflections = SEEN, Reflection.joined([ACTED, ACTED._replace(sign=torch.ones(4))])
    x, tradeoffs = torch.randn(2, 5, 13, generator=generator), torch.eye(2)

    def answer(asymmetry: float) -> torch.Tensor:
        family = Hypernetwork(Symmetric(plain, *reflections, asymmetry), 2)
        rows = [family.specialize(w)(each) for w, each in zip(tradeoffs, x, strict=True)]
        found = family.run(family(tradeoffs), x)
        torch.testing.assert_close(found, torch.stack(rows))
        return found

    torch.testing.assert_close(answer(1.0), plain(x))
    torch.testing.assert_close(answer(0.3), 0.7 * answer(0.0) + 0.3 * plain(x))


FLIPPED = "abdomen_x", "abdomen_z", "ankle_x", "shoulder", "torso.y", "rot", "slider2"


@pytest.mark.parametrize(
    "task", ["walker", "humanoid", "pgmorl/walker2d", "mo-gymnasium/humanoid", "pgmorl/swimmer"]
)
def test_a_mirror_exchanges_left_and_right_joints_and_motors(task):
    env = envs.make(task, 1, "cpu")
    mirror, parts = env.mirror(), env.layout()
    names = [part.name for part in parts for _ in range(part.size)]
    order, sign = (values.tolist() for values in mirror.observation)
    for name, other, factor in zip(names, [names[i] for i in order], sign, strict=True):
        sides = {"right": "left", "left": "right"}
        if "walker2d" in task:
            sides = {"_left_joint": "_joint", "_joint": "_left_joint"}
        side = next((side for side in sides if side in name), "")
        assert other == name.replace(side, sides.get(side, ""), 1)
        if names.count(name) == 1:
            assert factor == (-1.0 if any(part in name for part in FLIPPED) else 1.0)
    joints = [env.physics.model.joint(i).name for i in env.physics.model.actuator_trnid[:, 0]]
    seen = [names.index(f"position.{joint}") for joint in joints]
    assert [seen[i] for i in mirror.action.order.tolist()] == [order[i] for i in seen]
    assert mirror.action.sign.tolist() == [sign[i] for i in seen]
    x = torch.randn(3, len(names))
    assert torch.equal(mirror.observation(mirror.observation(x)), x)


@pytest.mark.parametrize(
    ("task", "reason"),
    [
        ("hopper", "it has no left and right"),
        ("ant", "its mirror image has other rewards of the objective vy"),
        ("bruce", "right_ankle_crank has no mirrored partner"),
    ],
)
def test_robots_without_a_mirror_are_refused(task, reason):
    with pytest.raises(MorlaxError, match=reason):
        envs.make(task, 1, "cpu").mirror()


def test_asymmetry_without_symmetry_is_refused():
    with pytest.raises(MorlaxError, match=r"network\.asymmetry needs network\.symmetric"):
        tiny("walker", **{"network.asymmetry": 0.3})


def test_worlds_that_know_no_mirror_are_refused():
    with pytest.raises(MorlaxError, match=r"network\.symmetric needs worlds that know left from"):
        Worlds.mirror(envs.make("hopper", 1, "cpu"))
