"""Saved policies give the same actions, and unusable inputs or files give clear errors."""

import copy
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest
import torch
from same import assert_same
from tiny import learner, scaled, tiny, varied

import morlax_torch
from morlax_torch import MORLAX, MorlaxError, Policy, save
from morlax_torch.algorithms.learner import make_agent
from morlax_torch.networks.mlp import Linear
from morlax_torch.runs import checkpoint
from morlax_torch.runs.progress import Progress

TRADEOFFS = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.3, 0.7], [0.5, 0.5]])


def made(env: str = "hopper", **changes: object) -> MORLAX:
    with scaled():
        return learner(tiny(env, **changes))


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, MORLAX]:
    """Write a run folder whose observation normalizer has been updated."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "checkpoints").mkdir()
    morlax = made()
    noise = torch.randn(100, morlax.env.observation_size, generator=torch.Generator())
    morlax.agent.observation_normalizer.update(1.0 + 2.0 * noise)
    path, progress = folder / "checkpoints" / "latest.pt", Progress(best_hypervolume=1.0)
    checkpoint.write(path, checkpoint.snapshot(morlax), progress)
    return folder, morlax


@pytest.fixture
def latest(saved) -> Path:
    return saved[0] / "checkpoints" / "latest.pt"


@pytest.fixture
def policy(saved) -> Policy:
    return morlax_torch.load(saved[0])


@pytest.fixture
def observation(saved, generator) -> torch.Tensor:
    return torch.randn(4, saved[1].env.observation_size, generator=generator)


def test_a_loaded_policy_gives_the_saved_agent_s_actions(saved, policy, observation):
    agent = saved[1].agent
    expected = agent.policies(TRADEOFFS)(agent.observation_normalizer(observation)[:, None])
    torch.testing.assert_close(policy(observation, TRADEOFFS), expected.mean[:, 0].tanh())
    assert not policy(observation, TRADEOFFS).requires_grad


def test_each_row_can_have_its_own_tradeoff(policy, observation):
    together = policy(observation, TRADEOFFS)
    assert together.shape == (4, policy.specialize(TRADEOFFS[0])(observation).shape[1])
    assert together.abs().max() < 1
    for row, tradeoff in enumerate(TRADEOFFS):
        alone = policy(observation[row : row + 1], tradeoff)
        torch.testing.assert_close(together[row : row + 1], alone)
        torch.testing.assert_close(policy(observation[row], tradeoff), alone[0])
        torch.testing.assert_close(policy(observation[row], tradeoff[None]), alone[0])
        same = policy(observation, tradeoff)
        torch.testing.assert_close(same, policy(observation, tradeoff.expand(4, 2)))
        torch.testing.assert_close(same, policy.specialize(tradeoff)(observation))
    assert (policy(observation[:1].expand(4, -1), TRADEOFFS).std(0) > 1e-3).all()


def test_trade_offs_can_be_mapped_and_exported(policy, observation):
    expected = policy(observation, TRADEOFFS)
    torch.testing.assert_close(torch.vmap(policy)(observation, TRADEOFFS), expected)
    program = torch.export.export(policy, (observation, TRADEOFFS))
    torch.testing.assert_close(program.module()(observation, TRADEOFFS), expected)


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:.*torch.jit:FutureWarning")
def test_a_specialized_policy_is_a_plain_module(policy, observation, tmp_path):
    fixed = policy.specialize([0.3, 0.7])
    assert isinstance(fixed, torch.nn.Module)
    assert not any(parameter.requires_grad for parameter in fixed.parameters())
    assert sum(p.numel() for p in fixed.parameters()) < sum(p.numel() for p in policy.parameters())
    exported = torch.export.export(fixed, (observation,)).module()
    torch.testing.assert_close(exported(observation), fixed(observation))
    torch.jit.script(fixed).save(tmp_path / "policy.ts")
    scripted = torch.jit.load(tmp_path / "policy.ts")
    for seen in (observation, observation[0], 1e3 * observation):  # clipped alike
        assert torch.equal(scripted(seen), fixed(seen))


@pytest.mark.parametrize(
    "form",
    (
        list,
        lambda w: np.array(w, dtype=np.float32),
        lambda w: 1000 * torch.tensor(w, dtype=torch.float64),  # they need not sum to one
        lambda w: (10 * torch.tensor(w)).round().long(),
    ),
)
def test_tradeoffs_can_be_lists_tuples_arrays_or_tensors(policy, observation, form):
    one, many = TRADEOFFS[2].tolist(), TRADEOFFS.tolist()
    expected = policy(observation, TRADEOFFS[2])
    torch.testing.assert_close(policy(observation, form(one)), expected)
    torch.testing.assert_close(policy.specialize(form(one))(observation), expected)
    torch.testing.assert_close(policy(observation, form(many)), policy(observation, TRADEOFFS))


KINDS = [
    {"network.type": "dual"},
    {"network.symmetric": True},
    {"algorithm": "independent"},
    {"algorithm": "amor"},
]


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:.*torch.jit:FutureWarning")
@pytest.mark.parametrize("changes", KINDS, ids=str)
def test_specialized_policies_of_every_kind_can_be_scripted(observation, changes):
    fixed = varied(**changes).specialize([0.3, 0.7])
    scripted = torch.jit.script(fixed)
    for seen in (observation, observation[0]):
        assert torch.equal(scripted(seen), fixed(seen))
    torch.testing.assert_close(fixed(observation[0]), fixed(observation)[0])


@pytest.mark.parametrize("changes", KINDS, ids=str)
def test_threads_can_share_a_policy(observation, tmp_path, monkeypatch, changes):
    policy, usual = varied(**changes), Linear.forward
    expected = [policy(observation, w) for w in TRADEOFFS]
    assert not torch.allclose(expected[0], expected[1], atol=0.1)
    together = Barrier(3, timeout=10)

    def forward(layer: Linear, x: torch.Tensor) -> torch.Tensor:
        together.wait()  # every thread is inside the network now
        return usual(layer, x)

    def act(tradeoff: torch.Tensor) -> torch.Tensor:
        return policy(observation, tradeoff)

    def copied(tradeoff: torch.Tensor) -> torch.Tensor:
        return copy.deepcopy(policy)(observation, tradeoff)

    with monkeypatch.context() as patch, ThreadPoolExecutor(3) as pool:
        patch.setattr(Linear, "forward", forward)
        tasks = [pool.submit(run, w) for run, w in zip((act, act, copied), TRADEOFFS, strict=False)]
        actions = [task.result() for task in tasks]
    save(policy, tmp_path / "policy.pt")
    for k, w in enumerate(TRADEOFFS):
        assert k > 2 or torch.equal(actions[k], expected[k])
        assert torch.equal(policy(observation, w), expected[k])
        torch.testing.assert_close(policy.specialize(w)(observation), expected[k])
        assert torch.equal(morlax_torch.load(tmp_path / "policy.pt")(observation, w), expected[k])


def test_torch_s_defaults_change_no_action(dtypes):
    actions = []
    for _ in dtypes:
        policy = morlax_torch.load("cheetah")
        seen = torch.linspace(-3, 3, 17, dtype=torch.float32, device="cpu")
        seen = [seen, seen.tolist(), seen.double()]  # a list of the default dtype
        actions.append([policy(x, w) for x in seen for w in ((1, 1), [0.3, 0.7])])
        actions[-1] += [policy.specialize((0.3, 0.7))(seen[0])]
    assert_same(*actions)
    assert all(action.dtype == torch.float32 for action in actions[1])


BAD_TRADEOFFS = {
    "negative": ([-0.5, 1.5], "negative"),
    "zero": ([0.0, 0.0], "zero in every objective"),
    "too long": ([0.2, 0.3, 0.5], r"2 numbers \(run, jump\)"),
    "not a number": ([float("nan"), 1.0], "trade-off"),
    "one bad row": ([[0.5, 0.5], [1.0, 0.0], [0.0, 0.0], [1.0, 1.0]], "zero in every objective"),
}


@pytest.mark.parametrize("which", BAD_TRADEOFFS)
def test_invalid_tradeoffs_give_clear_errors(policy, observation, which):
    tradeoff, words = BAD_TRADEOFFS[which]
    with pytest.raises(MorlaxError, match=words):
        policy(observation, tradeoff)
    with pytest.raises(MorlaxError):
        policy.specialize(tradeoff)


@pytest.mark.parametrize("number", (2, 13))  # a hopper observes 13 numbers
def test_one_observation_has_one_tradeoff(policy, observation, number):
    with pytest.raises(MorlaxError, match=f"observations is 1, but that of trade-offs {number}"):
        policy(observation[0], torch.ones(number, 2))


def test_the_best_checkpoint_is_loaded_before_the_latest(saved, tmp_path):
    with pytest.raises(MorlaxError, match="does not exist"):
        morlax_torch.load(tmp_path / "nowhere")
    with pytest.raises(MorlaxError, match="has no checkpoints"):
        morlax_torch.load(tmp_path)
    with pytest.raises(MorlaxError, match="no checkpoint"):
        checkpoint.load(tmp_path / "nowhere.pt")
    folder = tmp_path / "checkpoints"
    folder.mkdir()
    checkpoint.write(folder / "latest.pt", checkpoint.snapshot(saved[1]), Progress())
    assert morlax_torch.load(tmp_path).config.seed == 0
    checkpoint.write(folder / "best.pt", checkpoint.snapshot(made(seed=5)), Progress())
    assert morlax_torch.load(str(tmp_path)).config.seed == 5
    assert morlax_torch.load(folder / "latest.pt").config.seed == 0


def test_a_file_that_is_not_a_checkpoint_gives_a_clear_error(latest, tmp_path):
    path, whole = tmp_path / "other.pt", latest.read_bytes()
    for damaged in (b"", b"\x80\x02.", whole[: len(whole) // 2], whole[:-1]):
        path.write_bytes(damaged)
        with pytest.raises(MorlaxError, match=r"other\.pt is damaged or not a checkpoint"):
            morlax_torch.load(path)
    for contents in (torch.zeros(3), {"weights": torch.zeros(3)}):
        torch.save(contents, path)
        with pytest.raises(MorlaxError, match="is damaged or not a checkpoint"):
            morlax_torch.load(path)
    torch.save({**torch.load(latest), "format": 99}, path)
    with pytest.raises(MorlaxError, match="format 99"):
        morlax_torch.load(path)


def test_loading_a_checkpoint_runs_no_pickled_code(tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "sprung",))

    torch.save({"format": 1, "trap": Trap()}, tmp_path / "trap.pt")
    with pytest.raises(MorlaxError, match="damaged or not a checkpoint"):
        morlax_torch.load(tmp_path / "trap.pt")
    assert not (tmp_path / "sprung").exists()


MISMATCHES = {
    r"has objectives \('run', 'jump'\), but the task has": {"env": "walker"},
    "does not fit this learner: state": {"worlds": 32},
    "fit this learner: .* instead of": {"network.actor": (7,)},
}


@pytest.mark.parametrize("words", MISMATCHES)
def test_a_checkpoint_is_not_restored_into_a_different_learner(latest, words):
    other = made(**MISMATCHES[words])
    before = {name: value.clone() for name, value in other.agent.state_dict().items()}
    with pytest.raises(MorlaxError, match=words):
        checkpoint.restore(checkpoint.load(latest), latest, other)
    assert_same(dict(other.agent.state_dict()), before)


def test_saved_policies_omit_the_critic_and_give_the_same_actions(policy, observation, tmp_path):
    save(policy, tmp_path / "family.pt")
    again = morlax_torch.load(tmp_path / "family.pt")
    for tradeoff in TRADEOFFS:
        assert torch.equal(again(observation, tradeoff), policy(observation, tradeoff))
    assert again.objectives == ("run", "jump") and again.config == policy.config
    contents = checkpoint.load(tmp_path / "family.pt")
    assert not any("critic" in name for name in contents.policy)
    with pytest.raises(MorlaxError, match="only policies"):
        checkpoint.restore(contents, tmp_path / "family.pt", made())


@pytest.mark.parametrize("turn", [lambda p: p.double(), lambda p: p.to(torch.float16)])
def test_a_policy_stays_in_float32(policy, observation, turn):
    before = policy(observation, (0.3, 0.7))
    with pytest.raises(MorlaxError, match=r"policies compute in float32, not torch\.float"):
        turn(policy)
    assert torch.equal(policy.to("cpu").float()(observation, (0.3, 0.7)), before)
    plain = policy.specialize((0.3, 0.7)).double()  # a plain module can be anything
    torch.testing.assert_close(plain(observation.double()).float(), before)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(policy(observation, tradeoff=(0.3, 0.7)), before)
        special = policy.specialize((0.3, 0.7))
    torch.testing.assert_close(special(observation), before)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (torch.zeros(5, 12), r"shape \(5, 12\), but this policy needs \(B, 13\)"),
        (torch.zeros(5, 13, dtype=torch.int64), "must be floats, not torch.int64"),
        ("nothing", "consist of numbers, not 'nothing'"),
    ],
)
def test_other_observations_are_refused_in_one_sentence(policy, given, words):
    with pytest.raises(MorlaxError, match=words):
        policy(given, (0.3, 0.7))


def test_reward_weights_combine_terms_as_training_did():
    changes = {"task.guide": {"alive": 0.5, "jump": 2.0}, "task.shared": {"alive": 1.0}}
    config = tiny("hopper", **changes)
    env = config.make_worlds(4, 0)
    policy = Policy(make_agent(env, config), config, env.objectives)
    weights = policy.reward_weights([3.0, 1.0])
    for _ in range(3):
        step = env.step(torch.ones(4, env.action_size))
        utility = step.reward @ torch.tensor([0.75, 0.25])
        combined = sum(weight * step.terms[name] for name, weight in weights.items())
        torch.testing.assert_close(combined.float(), utility)
    bent = config.model_copy(update={"scalarization": "chebyshev"})
    with pytest.raises(MorlaxError, match="did not learn from fixed weights"):
        Policy(policy.agent, bent, env.objectives).reward_weights([3.0, 1.0])
