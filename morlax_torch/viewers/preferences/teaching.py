"""Teach an objective by comparisons: clips, answers, a learned reward, a config to train with."""

import hashlib
from pathlib import Path

import numpy as np

from ...configuration.config import Config, load_config
from ...configuration.files import write_yaml
from ...envs import MorlaxError, TaskOptions
from ...envs.making import check_seed
from ...envs.worlds.learned import TERM
from ...envs.worlds.options import check_objectives
from ...host.files import make_folder, write_file
from ...host.phases import phase
from ...runs.loading import find_checkpoint, load
from . import reward
from .comparisons import Comparisons, record
from .reward import Fit


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
        if clips < 2:
            raise MorlaxError(f"there are {clips} clips: at least 2 are needed to compare.")
        check_seed(seed)
        self.folder, self.objective = folder, objective
        self._checkpoint, self._seed = find_checkpoint(run), seed
        self.policy = load(run)
        task = self.policy.config.task
        assert isinstance(task, TaskOptions)
        if TERM not in task.objectives.get(objective, [TERM]):
            raise MorlaxError(
                f"{run} has an objective {objective} already, which is not learned: choose another "
                "name."
            )
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
        self._random = np.random.default_rng([seed, len(self.comparisons.answers)])

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
        """Write the answers given so far."""
        make_folder(self.folder)
        self.comparisons.save(self.folder / "comparisons.npz")

    def pair(self) -> tuple[int, int]:
        """Return the indices of two clips to compare next."""
        return self.comparisons.pair(self._random)

    def judge(self, term: str, answers: int) -> None:
        """Answer as a simulated user who prefers more of a reward term."""
        self.comparisons.judge(term, answers, self._random)
        self.save()

    def finish(self) -> Fit:
        """Fit a reward to the answers, and write it with a config to train with."""
        self.save()
        phase("learning the reward")
        fitted = reward.fit(self.comparisons, self._seed)
        reward.save(fitted.reward, self.folder / "learned.pt")
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
            point = task.reference_point
            options["reference_point"] = None if point is None else [*point, 0.0]
        options["learned"] = str((self.folder / "learned.pt").absolute())
        start = {"start_from": str(self._checkpoint), "device": None, "backend": None}
        return load_config({**values, **start})
