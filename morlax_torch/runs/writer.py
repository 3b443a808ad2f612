"""Write a run's files in a thread, while training goes on."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Self

from .progress import Evaluation

Job = Callable[[], Evaluation | None]


class Writer:
    """Runs jobs one after the other in a thread of its own.

    `results` raises the first error of a job, and later jobs are dropped. On exit, wait for all
    jobs, then raise the first unreported job error unless the block itself failed. At most
    `most_waiting` jobs are unfinished when `put` returns.
    """

    def __init__(self, most_waiting: int):
        self._most_waiting = most_waiting
        self._thread = ThreadPoolExecutor(1, "morlax-writer")
        self._jobs: deque[Future[Evaluation | None]] = deque()
        self._failed = False

    def put(self, job: Job) -> None:
        """Queue a job, and wait while too many are unfinished."""
        self._jobs.append(self._thread.submit(self._run, job))
        wait(list(self._jobs)[: max(0, len(self._jobs) - self._most_waiting)])

    def results(self, all_of_them: bool = False) -> Iterator[Evaluation]:
        """Yield the evaluations of finished jobs, in order, each once; raise a job's first error.

        `all_of_them`: wait for unfinished jobs too.
        """
        while self._jobs and (all_of_them or self._jobs[0].done()):
            wait([self._jobs[0]])
            evaluation = self._jobs.popleft().result()
            if evaluation is not None:
                yield evaluation

    def _run(self, job: Job) -> Evaluation | None:
        if self._failed:
            return None
        try:
            return job()
        except BaseException:
            self._failed = True
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._thread.shutdown()
        if kind is None or issubclass(kind, GeneratorExit):
            for _ in self.results():
                pass
