"""Answers to "which clip is better?", in a file with the clips."""

import io
from collections.abc import Iterable
from typing import Self

import numpy as np

from ...envs import MorlaxError
from ...envs.errors import LONGEST, unknown
from ...host.files import AnyPath, read, replacing
from .clips import Clips


class Comparisons:
    """Clips of one task, and which of two of them a user preferred.

    Args:
        task: its name.
        terms: names of the reward terms of the clips.
        clips: to compare.
        answers: pairs of indices of clips, the preferred one first.
        sources: names of where the clips come from.
        objective: what the answers are about (None: not told).
    """

    def __init__(
        self,
        task: str,
        terms: list[str],
        clips: Clips,
        answers: Iterable[tuple[int, int]] = (),
        sources: Iterable[str] = (),
        objective: str | None = None,
    ):
        self.task, self.terms, self.clips, self.objective = task, terms, clips, objective
        self.answers, self.sources = list(answers), list(sources)

    def __len__(self) -> int:
        return len(self.answers)

    def pair(self, random: np.random.Generator) -> tuple[int, int]:
        """Draw two different clips to compare next, one of them of those compared least."""
        times = np.bincount(np.array(self.answers, int).ravel(), minlength=len(self.clips.action))
        first, *others = np.lexsort([random.random(len(times)), times])
        return int(first), int(random.choice(others))

    def answer(self, preferred: int, other: int) -> None:
        """Note that one clip is preferred to another, both by index."""
        self.answers.append((preferred, other))

    def add(self, task: str, terms: list[str], clips: Clips) -> None:
        """Add clips of the same task.

        Raises:
            MorlaxError: they are of another task, or of another length.
        """
        own = [part.shape[1:] for part in self.clips]
        if task != self.task or terms != self.terms or own != [part.shape[1:] for part in clips]:
            raise MorlaxError(
                f"the comparisons are of clips of {self.task}, so no clips of {task} can be added: "
                "use another folder."
            )
        joined = zip(self.clips, clips, strict=True)
        self.clips = Clips(*(np.concatenate(parts) for parts in joined))

    def judge(self, term: str, number: int, random: np.random.Generator) -> None:
        """Answer `number` comparisons as a simulated user who prefers more of a reward term.

        Raises:
            MorlaxError: the task has no such reward term.
        """
        if term not in self.terms:
            raise unknown("reward term", term, self.terms)
        ratings = self.clips.terms[:, self.terms.index(term)]
        for _ in range(number):
            one, other = self.pair(random)
            self.answer(*((one, other) if ratings[one] > ratings[other] else (other, one)))

    def save(self, path: AnyPath) -> None:
        """Write an .npz, atomically.

        Raises:
            MorlaxError: the file cannot be written.
        """
        answers = np.array(self.answers, np.int32).reshape(-1, 2)
        with replacing(path) as file:
            np.savez_compressed(
                file,
                task=self.task,
                objective=self.objective or "",
                term_names=np.array(self.terms, str),
                sources=np.array(self.sources, str),
                answers=answers,
                **self.clips._asdict(),
            )

    @classmethod
    def load(cls, path: AnyPath) -> Self:
        """Read a file that `save` wrote.

        Raises:
            MorlaxError: there is no such file, or it is damaged.
        """
        whole = io.BytesIO(read(path, "file of comparisons"))
        try:
            with np.load(whole) as arrays:
                clips = Clips(*(arrays[name] for name in Clips._fields))
                terms, answers = arrays["term_names"].tolist(), arrays["answers"]
                task, sources = str(arrays["task"]), arrays["sources"].tolist()
                objective = str(arrays["objective"]) or None
            _check(clips, terms, answers)
        except MemoryError:
            raise
        except Exception as error:  # numpy, zip and zlib each fail in their own way
            reason = " ".join(str(error).split())[:LONGEST].rstrip(".")
            raise MorlaxError(
                f"{path} is damaged or not a file of comparisons: {reason}."
            ) from None
        pairs = [(int(a), int(b)) for a, b in answers]
        return cls(task, terms, clips, pairs, sources, objective)


def _check(clips: Clips, terms: list[str], answers: np.ndarray) -> None:
    """Raise ValueError if sizes disagree, or a number is not finite or out of range."""
    n, length = clips.action.shape[:2]
    shapes = {"observation": (n, length + 1), "qpos": (n, length + 1), "terms": (n, len(terms))}
    for name, values in clips._asdict().items():
        wanted = shapes.get(name, (n, length))
        dimensions = 2 if name == "terms" else 3
        if values.ndim != dimensions or values.shape[:2] != wanted or values.dtype != np.float32:
            raise ValueError(f"{name} has the wrong shape or type")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} must be finite")
    if answers.ndim != 2 or answers.shape[1] != 2 or answers.dtype != np.int32:
        raise ValueError("answers must be pairs of clips")
    if ((answers < 0) | (answers >= n)).any() or (answers[:, 0] == answers[:, 1]).any():
        raise ValueError("an answer must name two different clips of the file")
