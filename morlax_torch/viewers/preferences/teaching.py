"""Teach an objective by comparisons: clips, answers, a learned reward, a config to train with."""

import hashlib
import io
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import softplus

from ... import envs
from ...configuration.config import Config, load_config
from ...configuration.files import write_yaml
from ...configuration.tradeoffs import dirichlet_tradeoffs
from ...envs import Environment, MorlaxError, TaskOptions
from ...envs.errors import LONGEST, line, unknown
from ...envs.making import check_seed
from ...envs.worlds.learned import TERM, LearnedReward
from ...envs.worlds.options import check_objectives
from ...host.files import AnyPath, make_folder, read, replacing, write_file
from ...host.phases import phase
from ...networks.policy import Policy
from ...runs.loading import find_checkpoint, load

SECONDS = 1.5  # length of a clip
EPISODE = 1000  # control steps at most of an episode that clips are cut from
FEWEST = 10  # answers to learn from
HELD_OUT = 0.2  # share of answers that measure the accuracy
MISTAKES = 0.1  # share of answers that a user gives at random
SAMPLED = 25  # steps of a clip that are rated; its neighboring steps are much alike
EPOCHS, BATCH, RATE, DECAY = 60, 32, 2e-3, 1e-2


class Clips(NamedTuple):
    """n clips of L control steps each."""

    observation: NDArray[np.float32]  # (n, L + 1, O)
    action: NDArray[np.float32]  # (n, L, A)
    qpos: NDArray[np.float32]  # (n, L + 1, nq), to show them
    terms: NDArray[np.float32]  # (n, k) sums of the task's own reward terms


def record(policy: Policy, number: int, seed: int = 0) -> tuple[Clips, list[str]]:
    """Record clips of random trade-offs, each at a random time of an episode, on C MuJoCo.

    Every second clip has exploration noise, to show what training may try. Some of the `number`
    episodes may end too early for a clip. Returns the clips, and the names of their reward terms.
    """
    config, m = policy.config, len(policy.objectives)
    if not issubclass(envs.get(config.env), Environment):
        raise MorlaxError(f"{config.env} has no MuJoCo robot, so its clips cannot be compared.")
    options = config.task.for_evaluation().model_dump()
    env = envs.make(config.env, number, "cpu", "mujoco", seed, auto_reset=False, **options)
    assert isinstance(env, Environment)
    policy.agent.check_sizes(env)
    length, steps = max(1, round(SECONDS / env.dt)), min(env.episode_length, EPISODE)
    actors = policy.agent.actors(dirichlet_tradeoffs(number, m, seed=seed))
    generator = torch.Generator().manual_seed(seed)
    names = [name for name in env.reward_terms if name != TERM]  # that the task itself defines
    alive = torch.full((number,), steps)
    observation = env.reset()
    seen, positions, actions, terms = [observation], [env.physics.qpos.clone()], [], []
    with torch.no_grad():
        for time in range(steps):
            phase(f"recording {number} clips", time / steps)
            chosen = actors.distribution(observation[:, None])
            noise = chosen.noise(generator)
            noise[::2] = 0
            actions.append((chosen.mean + chosen.std * noise).tanh()[:, 0])
            step = env.step(actions[-1])
            observation = step.observation
            seen.append(observation)
            positions.append(env.physics.qpos.clone())
            terms.append(torch.stack([step.terms[name] for name in names], -1))
            alive[step.terminated] = alive[step.terminated].clamp(max=time)
    rows = torch.nonzero(alive >= length).squeeze(-1)
    if len(rows) < 2:
        raise MorlaxError(
            f"fewer than two of {number} episodes last {SECONDS:g} s, the length of a clip: train "
            "for longer, or record more clips."
        )
    latest = (alive - length)[rows]
    draws = torch.rand(len(rows), generator=generator, dtype=torch.float32)
    first = (draws * (latest + 1)).long().minimum(latest)
    times = first[:, None] + torch.arange(length + 1)

    def cut(values: list[torch.Tensor], times: torch.Tensor) -> np.ndarray:
        return torch.stack(values)[times, rows[:, None]].float().numpy()

    action, sums = cut(actions, times[:, :-1]), cut(terms, times[:, :-1]).sum(1)
    return Clips(cut(seen, times), action, cut(positions, times), sums), names


@dataclass
class Comparisons:
    """Clips of one task, and which of two of them a user preferred."""

    task: str
    terms: list[str]  # names of the reward terms of the clips
    clips: Clips
    answers: list[tuple[int, int]] = field(default_factory=list)  # clips, the preferred one first
    sources: list[str] = field(default_factory=list)  # names of where the clips come from
    objective: str | None = None  # that the answers are about; None: not told

    def pair(self, random: np.random.Generator) -> tuple[int, int]:
        """Draw two different clips to compare next, one of them of those compared least."""
        times = np.bincount(np.array(self.answers, int).ravel(), minlength=len(self.clips.action))
        first, *others = np.lexsort([random.random(len(times)), times])
        return int(first), int(random.choice(others))

    def joined(self, other: "Comparisons") -> "Comparisons":
        """Add clips, or raise MorlaxError if they are of another task or of another length."""
        mine, others = ([part.shape[1:] for part in each.clips] for each in (self, other))
        if (other.task, other.terms, others) != (self.task, self.terms, mine):
            raise MorlaxError(f"the clips are of {self.task}: use another folder for {other.task}.")
        clips = Clips(*map(np.concatenate, zip(self.clips, other.clips, strict=True)))
        return replace(self, clips=clips, sources=self.sources + other.sources)

    def judge(self, term: str, number: int, random: np.random.Generator) -> None:
        """Answer `number` comparisons as a simulated user who prefers more of a reward term."""
        if term not in self.terms:
            raise unknown("reward term", term, self.terms)
        ratings = self.clips.terms[:, self.terms.index(term)]
        for _ in range(number):
            one, other = self.pair(random)
            self.answers.append((one, other) if ratings[one] > ratings[other] else (other, one))

    def save(self, path: AnyPath) -> None:
        """Write an .npz atomically, or raise MorlaxError."""
        with replacing(path) as file:
            np.savez_compressed(
                file,
                task=self.task,
                objective=self.objective or "",
                term_names=np.array(self.terms, str),
                sources=np.array(self.sources, str),
                answers=np.array(self.answers, np.int32).reshape(-1, 2),
                **self.clips._asdict(),
            )

    @classmethod
    def load(cls, path: AnyPath) -> Self:
        """Read a file that `save` wrote, or raise MorlaxError."""
        content = io.BytesIO(read(path, "file of comparisons"))
        try:
            with np.load(content) as arrays:
                clips = Clips(*(arrays[name] for name in Clips._fields))
                terms, sources = arrays["term_names"].tolist(), arrays["sources"].tolist()
                answers = [(int(a), int(b)) for a, b in arrays["answers"]]
                task, objective = str(arrays["task"]), str(arrays["objective"]) or None
            n, length = clips.action.shape[:2]
            sizes = [(n, length + 1), (n, length), (n, length + 1), (n, len(terms))]
            if [part.shape[:2] for part in clips] != sizes or np.max(answers, initial=0) >= n:
                raise ValueError("its clips and answers do not fit together")
        except Exception as error:  # numpy, zip and zlib each fail in their own way
            reason = line(error)[:LONGEST].rstrip(".")
            raise MorlaxError(f"{path} is damaged or has no comparisons: {reason}.") from None
        return cls(task, terms, clips, answers, sources, objective)


class Fit(NamedTuple):
    """A learned reward, and how well it predicts answers that it was not fitted to."""

    reward: LearnedReward
    accuracy: float
    checked: int  # answers that the accuracy is a share of


def fit(comparisons: Comparisons, seed: int = 0) -> Fit:
    """Fit the ensemble of a `LearnedReward` to answers, by Bradley and Terry's model.

    The probability that a clip is preferred is a logistic function of the difference of both
    clips' mean ratings, with a share of mistakes (Christiano et al., 2017, section 2.2.3). Each
    network sees its own bootstrap sample of the answers. Afterwards, rewards are shifted and scaled
    so that the clip with the lowest mean reward per step earns 0 and the one with the highest 1.
    `seed` draws parameters, samples and the answers that are held out.
    """
    answers = np.array(comparisons.answers).reshape(-1, 2)
    if len(answers) < FEWEST:
        raise MorlaxError(f"there are {len(answers)} answers: a reward needs at least {FEWEST}.")
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(len(answers), generator=generator).numpy()
    checked = max(1, round(HELD_OUT * len(answers)))
    observation, action, *_ = comparisons.clips
    reward = LearnedReward(observation.shape[-1], action.shape[-1], generator=generator)
    steps = steps_of(comparisons)
    flat = steps.flatten(0, 1)
    reward.mean.copy_(flat.mean(0))
    reward.scale.copy_(1 / flat.std(0).clamp(min=1e-4))
    _train(reward, steps, torch.from_numpy(answers[order[checked:]]), generator)
    with torch.no_grad():
        ratings = _clip_ratings(reward, steps).mean(0)
        reward.offset.copy_(ratings.min())
        reward.unit.copy_(ratings.max() - ratings.min())
    if not reward.unit > 1e-6:
        raise MorlaxError("the answers do not depend on the clips, so no reward can be learned.")
    preferred, other = ratings[torch.from_numpy(answers[order[:checked]])].T
    accuracy = float((preferred > other).float().mean())
    return Fit(reward.requires_grad_(False), accuracy, checked)


def steps_of(comparisons: Comparisons) -> Tensor:
    """Return evenly sampled steps (n, L, inputs) of all clips, as `LearnedReward` takes them."""
    observation, action = (torch.from_numpy(part) for part in comparisons.clips[:2])
    length = action.shape[1]
    times = torch.linspace(0, length - 1, min(SAMPLED, length), dtype=torch.float32).round().long()
    return torch.cat([observation[:, times], action[:, times], observation[:, times + 1]], -1)


def _train(
    reward: LearnedReward, steps: Tensor, answers: Tensor, generator: torch.Generator
) -> None:
    size = reward.members, len(answers)
    samples = answers[torch.randint(len(answers), size, generator=generator)]  # (E, number, 2)
    optimizer = torch.optim.AdamW(reward.parameters(), RATE, weight_decay=DECAY)
    for _ in range(EPOCHS):
        for part in samples.split(BATCH, 1):
            clips, indices = part.unique(return_inverse=True)
            ratings = _clip_ratings(reward, steps[clips])  # (E, clips)
            chosen = ratings.gather(1, indices.flatten(1)).view(indices.shape)
            optimizer.zero_grad()
            _loss(chosen[..., 0] - chosen[..., 1]).backward()
            optimizer.step()


def _loss(gain: Tensor) -> Tensor:
    """Return the negative log-likelihood of answers whose ratings differ by `gain` (E, B)."""
    # log(MISTAKES / 2 + (1 - MISTAKES) sigmoid(gain)), without overflow
    right = np.log(1 - MISTAKES) - softplus(-gain)
    return -torch.logaddexp(right, torch.full_like(right, np.log(MISTAKES / 2))).mean(1).sum()


def _clip_ratings(reward: LearnedReward, steps: Tensor) -> Tensor:
    """Return the mean rating (E, n) of the steps of clips (n, L, inputs)."""
    n, length, _ = steps.shape
    return reward.ratings(steps.flatten(0, 1)).view(-1, n, length).mean(-1)


class Lesson:
    """A folder in which an objective is learned from comparisons of a run's clips.

    comparisons.npz   clips and answers
    learned.pt        the reward learned from them, for `task.learned`
    config.yaml       the run's config with the objective, starting from the run's policies

    Another run of the same task adds its clips, for example the one that was trained with the
    objective, whose mistakes further answers can correct. A run that has no clips in the folder yet
    records `clips` of them.
    """

    def __init__(self, run: str, folder: Path, objective: str, clips: int = 200, seed: int = 0):
        try:
            check_objectives([objective, TERM])
        except ValueError as error:
            raise MorlaxError(f"{error}.") from None
        check_seed(seed)
        self.folder, self.objective = folder, objective
        self._checkpoint, self._seed = find_checkpoint(run), seed
        self.policy = load(run)
        task = self.policy.config.task
        assert isinstance(task, TaskOptions)
        if TERM not in task.objectives.get(objective, [TERM]):
            raise MorlaxError(f"{run} has an objective {objective} already: choose another name.")
        groups = {**task.objectives, "task.shared": task.shared}
        others = [name for name, terms in groups.items() if TERM in terms and name != objective]
        if others:
            raise MorlaxError(
                f"{run} has learned {others[0]} already, and a task has one learned reward: go on "
                f"with --objective {others[0]}, or teach another run."
            )
        self.comparisons = self._comparisons(clips)
        self.comparisons.objective = objective
        self.save()
        self.random = np.random.default_rng([seed, len(self.comparisons.answers)])

    def _comparisons(self, number: int) -> Comparisons:
        """Return the folder's comparisons, with clips of the run."""
        path = self.folder / "comparisons.npz"
        former = Comparisons.load(path) if path.exists() else None
        if former and former.answers and former.objective not in (None, self.objective):
            raise MorlaxError(
                f"{self.folder} has answers about {former.objective}, not about {self.objective}: "
                f"use another folder, or --objective {former.objective}."
            )
        source = hashlib.sha256(self._checkpoint.read_bytes()).hexdigest()
        if former and source in former.sources:
            return former
        clips, terms = record(self.policy, number, self._seed)
        new = Comparisons(self.policy.config.env, terms, clips, sources=[source])
        return former.joined(new) if former else new

    def save(self) -> None:
        """Write the answers so far."""
        make_folder(self.folder)
        self.comparisons.save(self.folder / "comparisons.npz")

    def finish(self) -> Fit:
        """Fit a reward to the answers, and write it with a config to train with."""
        self.save()
        phase("learning the reward")
        fitted = fit(self.comparisons, self._seed)
        with replacing(self.folder / "learned.pt") as file:
            torch.save(fitted.reward.contents(), file)
        write_file(self.folder / "config.yaml", write_yaml(self.config()))
        return fitted

    def config(self) -> Config:
        """Return the config of a run with one more objective, starting from this one.

        The objective's weight makes it vary as much between the clips as the others do on average.
        """
        config, task = self.policy.config, self.policy.config.task
        assert isinstance(task, TaskOptions)
        values = config.model_dump(mode="json")
        options = values["task"]
        if self.objective not in task.objectives:
            clips, names = self.comparisons.clips, self.comparisons.terms
            groups = task.objectives.values()
            weights = [[task.shared.get(n, 0.0) + g.get(n, 0.0) for n in names] for g in groups]
            rewards = clips.terms / clips.action.shape[1] @ np.array(weights).T  # (n, m) per step
            spread = round(float(np.ptp(rewards, axis=0).mean()), 4)
            options["objectives"][self.objective] = {TERM: spread}
            if task.reference_point is not None:
                options["reference_point"] = [*task.reference_point, 0.0]
        options["learned"] = str((self.folder / "learned.pt").absolute())
        start = {"start_from": str(self._checkpoint), "device": None, "backend": None}
        return load_config({**values, **start})
