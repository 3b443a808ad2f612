"""Teach an objective by comparisons: clips, answers, a learned reward, a config to train with."""

import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import softplus

from ...configuration.config import Config, load_config
from ...configuration.files import write_yaml
from ...envs import MorlaxError, TaskOptions
from ...envs.making import check_seed
from ...envs.worlds.learned import TERM, LearnedReward
from ...envs.worlds.options import check_objectives
from ...host.files import make_folder, replacing, write_file
from ...host.phases import phase
from ...runs.loading import find_checkpoint, load
from .comparisons import Comparisons, record

FEWEST = 10  # answers to learn from
HELD_OUT = 0.2  # share of answers that measure the accuracy
MISTAKES = 0.1  # share of answers that a user gives at random
SAMPLED = 25  # steps of a clip that are rated; its neighboring steps are much alike
EPOCHS, BATCH, RATE, DECAY = 60, 32, 2e-3, 1e-2


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


def save(reward: LearnedReward, path: Path) -> None:
    """Write a file that `task.learned` can name, atomically, or raise MorlaxError."""
    with replacing(path) as file:
        torch.save(reward.contents(), file)


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
            clips, places = part.unique(return_inverse=True)
            ratings = _clip_ratings(reward, steps[clips])  # (E, clips)
            chosen = ratings.gather(1, places.flatten(1)).view(places.shape)
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
        save(fitted.reward, self.folder / "learned.pt")
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
