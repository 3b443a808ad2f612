"""Learn a reward term from comparisons of clips."""

import io
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import softplus

from ...envs import MorlaxError
from ...envs.worlds.learned import LearnedReward
from ...host.files import write_file
from .comparisons import Comparisons

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
        raise MorlaxError(
            f"there are {len(answers)} answers: at least {FEWEST} are needed to learn a reward."
        )
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(len(answers), generator=generator).numpy()
    checked = max(1, round(HELD_OUT * len(answers)))
    before, action, after = steps_of(comparisons)
    reward = LearnedReward(before.shape[-1], action.shape[-1], generator=generator)
    steps = torch.cat([before, action, after], -1)  # (n, L, inputs)
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
    content = io.BytesIO()
    torch.save(reward.contents(), content)
    write_file(path, content.getbuffer())


def steps_of(comparisons: Comparisons) -> tuple[Tensor, Tensor, Tensor]:
    """Return evenly sampled steps of all clips: observations, actions and next observations."""
    observation, action = (torch.from_numpy(part) for part in comparisons.clips[:2])
    length = action.shape[1]
    times = torch.linspace(0, length - 1, min(SAMPLED, length), dtype=torch.float32).round().long()
    return observation[:, times], action[:, times], observation[:, times + 1]


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
