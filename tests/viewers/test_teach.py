"""An objective is learned from comparisons of clips, and trained as one more objective."""

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from same import assert_same

import morlax_torch
from morlax_torch import MorlaxError, config_for, envs
from morlax_torch.algorithms.registry import make_learner
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import read_yaml
from morlax_torch.configuration.tradeoffs import dirichlet_tradeoffs
from morlax_torch.envs.worlds.learned import LIMITS, LearnedReward
from morlax_torch.runs import checkpoint
from morlax_torch.runs.loading import pack, start_from
from morlax_torch.train import train
from morlax_torch.viewers.player import Player
from morlax_torch.viewers.preferences import teaching
from morlax_torch.viewers.preferences.teaching import SECONDS, Clips, Comparisons, Lesson, record

pytestmark = pytest.mark.usefixtures("single_thread")
SMALL = {
    "device": "cpu",
    "worlds": 32,
    "horizon": 5,
    "sampling.clusters": 4,
    "ppo.minibatches": 2,
    "evaluation.tradeoffs": 6,
    "task.episode_length": 200,
    "max_env_steps": 320,
}
THREE = {"run": {"run": 1.0}, "energy": {"energy": 1.0}, "tall": {"learned": 2.0}}


def saved(path: Path, observations: int = 17, actions: int = 6) -> Path:
    """Write a random reward, of cheetahs by default."""
    generator = torch.Generator().manual_seed(0)
    torch.save(LearnedReward(observations, actions, generator=generator).contents(), path)
    return path


def synthetic(number: int = 120, noise: float = 0.0) -> Comparisons:
    """Return clips of random walks, and answers for more of the first observed number."""
    random = np.random.default_rng(0)
    observation = random.normal(size=(number, 21, 4)).cumsum(1).astype(np.float32)
    action = random.normal(size=(number, 20, 2)).astype(np.float32)
    terms = observation[:, 1:, :1].sum(1) + noise * random.normal(size=(number, 1))
    clips = Clips(observation, action, observation[..., :3], terms.astype(np.float32))
    return Comparisons("walk", ["first"], clips)


@pytest.fixture(scope="module")
def base(tmp_path_factory) -> Path:
    """Return a short run of two objectives."""
    config = config_for("cheetah", **SMALL)
    return train(config, output=tmp_path_factory.mktemp("runs") / "base").folder


@pytest.fixture(scope="module")
def lesson(base, tmp_path_factory) -> Lesson:
    """Return a finished lesson on the height of the torso."""
    lesson = Lesson(str(base), tmp_path_factory.mktemp("lessons") / "tall", "tall", clips=20)
    lesson.comparisons.judge("height", 40, lesson.random)
    lesson.finish()
    return lesson


# the reward term


def test_the_learned_term_rates_every_step(tmp_path):
    path = saved(tmp_path / "learned.pt")
    env = envs.make("cheetah", 6, "cpu", objectives=THREE, learned=path, episode_length=4)
    learned = LearnedReward.load(path, 17, 6)
    before, generator = env.reset().clone(), torch.Generator().manual_seed(1)
    for _ in range(10):  # over two automatic resets
        action = 2 * torch.rand(6, 6, generator=generator) - 1
        step = env.step(action)
        expected = learned(before, action, step.final_observation)
        assert_allclose(step.terms["learned"], expected, rtol=1e-5, atol=1e-6)
        assert_allclose(step.reward[:, 2], step.terms["alive"] + 2 * expected, rtol=1e-5)
        before = step.observation.clone()


def test_ratings_are_those_of_plain_networks():
    learned = LearnedReward(3, 2, members=2, generator=torch.Generator().manual_seed(0))
    learned.mean += 0.5
    learned.scale *= 2
    learned.offset += 0.25
    learned.unit *= 4
    generator = torch.Generator().manual_seed(1)
    before, action, after = (torch.randn(50, n, generator=generator) for n in (3, 2, 3))
    total = np.zeros(50)
    for member in range(2):
        x = (torch.cat([before, action, after], 1).numpy() - 0.5) * 2
        layers = list(zip(learned.weights, learned.biases, strict=True))
        for weight, bias in layers[:-1]:
            x = x @ weight[member].detach().numpy() + bias[member].detach().numpy()
            x = np.where(x > 0, x, 0.01 * x)
        weight, bias = layers[-1]
        total += (x @ weight[member].detach().numpy() + bias[member].detach().numpy())[:, 0]
    found = learned(before, action, after).detach()
    expected = (total / 2 - 0.25) / 4
    assert expected.min() < LIMITS[0] < expected.max()
    assert_allclose(found, expected.clip(*LIMITS), rtol=1e-4, atol=1e-5)
    learned.offset += 100
    assert_allclose(learned(before, action, after).detach(), -0.25)


def damaged(path: Path) -> Path:
    data = bytearray(saved(path).read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes(data)
    return path


MISTAKES = {
    "damaged": (damaged, "is damaged or not one: fit it again"),
    "missing": (lambda path: path, "cannot read the learned reward .*No such file"),
    "of another task": (lambda path: saved(path, 13, 6), "for 13 observations and 6 actions"),
}


@pytest.mark.parametrize(("make", "message"), MISTAKES.values(), ids=MISTAKES)
def test_a_wrong_file_is_one_sentence(make, message, tmp_path):
    path = make(tmp_path / "learned.pt")
    with pytest.raises(MorlaxError, match=message):
        envs.make("cheetah", 1, "cpu", objectives=THREE, learned=path)


# clips and comparisons


def test_clips_show_the_policies_of_their_trade_offs(base):
    policy = morlax_torch.load(base)
    clips, names = record(policy, 6, seed=3)
    again, _ = record(policy, 6, seed=3)
    assert_same([torch.from_numpy(c) for c in clips], [torch.from_numpy(c) for c in again])
    assert clips.action.shape == (6, round(SECONDS / 0.01), 6)
    assert_allclose(clips.qpos[:, :, 1:], clips.observation[:, :, :8], atol=1e-6)
    tradeoffs = dirichlet_tradeoffs(6, 2, seed=3)
    for clip in (0, 2, 4):  # the others have exploration noise
        expected = policy(clips.observation[clip, :-1], tradeoffs[clip])
        assert_allclose(clips.action[clip], expected, atol=1e-5)
    for name, expected in (("height", clips.qpos[:, 1:, 1] + 0.2), ("alive", np.ones((6, 150)))):
        assert_allclose(clips.terms[:, names.index(name)], expected.sum(1), rtol=1e-4)
    smooth = [np.abs(np.diff(clip, axis=0)).mean() for clip in clips.action]
    assert max(smooth[::2]) < 0.5 * min(smooth[1::2])


# learning


def test_the_loss_is_that_of_bradley_and_terry():
    gain = torch.tensor([[-3.0, 0.5, 2.0]])
    chance = 0.05 + 0.9 / (1 + np.exp(-gain.numpy()))
    assert float(teaching._loss(gain)) == pytest.approx(-np.log(chance).mean(), rel=1e-5)


@pytest.mark.slow
def test_a_reward_is_learned_from_comparisons():
    comparisons = synthetic(noise=2.0)
    comparisons.judge("first", 200, np.random.default_rng(0))
    fitted = teaching.fit(comparisons)
    assert fitted.checked == 40 and fitted.accuracy > 0.85
    steps = teaching.steps_of(comparisons).flatten(0, 1)
    rated = (fitted.reward.ratings(steps).mean(0) - fitted.reward.offset) / fitted.reward.unit
    means = rated.view(120, -1).mean(1).numpy()
    assert np.corrcoef(means, comparisons.clips.observation[:, :, 0].mean(1))[0, 1] > 0.9
    assert_allclose([means.min(), means.max()], [0, 1], atol=1e-4)


# lessons


def test_a_lesson_continues_with_its_answers(base, lesson):
    again = Lesson(str(base), lesson.folder, "tall", clips=20)
    assert again.comparisons.answers == lesson.comparisons.answers
    assert len(again.comparisons.clips.action) == len(lesson.comparisons.clips.action)
    assert again.comparisons.pair(again.random) not in lesson.comparisons.answers


def test_a_lesson_s_objective_varies_as_much_as_the_others(lesson):
    clips, task = lesson.comparisons.clips, lesson.config().task
    steps = clips.action.shape[1]
    alive, run, energy = (clips.terms[:, i] / steps for i in range(3))
    expected = (np.ptp(alive + run) + np.ptp(alive + energy)) / 2
    assert task.objectives["tall"]["learned"] == pytest.approx(expected, abs=1e-3)


def test_training_continues_with_one_more_objective(lesson, tmp_path):
    config = load_config(read_yaml(lesson.folder / "config.yaml"))
    moved = tmp_path / "moved"
    train(config, output=tmp_path / "run").folder.rename(moved)
    hidden = lesson.folder.rename(tmp_path / "hidden")  # the run has its own copy
    try:
        policy = morlax_torch.load(moved)
        assert policy.objectives == ("run", "energy", "tall")
        player = Player(policy, (0.0, 0.0, 1.0))
        player.step()
        assert player.returns[2] != 0
        with pytest.raises(MorlaxError, match=r"has learned tall already.* --objective tall"):
            Lesson(str(moved), tmp_path / "second", "calm", clips=4)
        assert not (tmp_path / "second").exists()
        pack(str(moved), tmp_path / "packed", "cpu")
        shutil.rmtree(moved)
        assert Player(morlax_torch.load(tmp_path / "packed"), (0, 0, 1)).env.objectives[2] == "tall"
    finally:
        hidden.rename(lesson.folder)


# starting from another run


def started(base: Path, **changes):
    config = config_for("cheetah", **{**SMALL, "start_from": str(base), **changes})
    learner = make_learner(config.make_worlds(config.worlds, config.seed), config)
    start_from(str(base), learner)
    return learner


def test_the_policies_of_known_objectives_stay(base, tmp_path):
    old = morlax_torch.load(base)
    torch.nn.init.normal_(old.agent.actor.weight, std=0.1)  # trade-offs then differ
    (tmp_path / "other" / "checkpoints").mkdir(parents=True)
    morlax_torch.save(old, tmp_path / "other" / "checkpoints" / "best.pt")
    changes = {"objectives": THREE, "learned": str(saved(tmp_path / "learned.pt"))}
    agent = started(tmp_path / "other", task=changes).agent
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
