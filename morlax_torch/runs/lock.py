"""A lock per run, so that only one process trains it."""

import os
from contextlib import suppress
from pathlib import Path

from filelock import FileLock, Timeout

from ..envs import MorlaxError


class RunLock:
    """The lock of a run's folder.

    The operating system releases it when its process ends, however it ends, so no lock is ever
    stale. `train.pid` names the process for error messages.
    """

    def __init__(self, folder: Path):
        self._folder, self._owner = folder, folder / "train.pid"
        self._lock = FileLock(folder / "train.lock", timeout=0)

    def acquire(self) -> None:
        """Take the lock.

        Raises:
            MorlaxError: another process, or another run object of this one, holds it, or the folder
                cannot be written.
        """
        try:
            self._lock.acquire()
            self._owner.write_text(str(os.getpid()))
        except Timeout:
            owner = "another process"
            with suppress(OSError):
                owner = f"process {self._owner.read_text()}"
            raise MorlaxError(
                f"{self._folder} is being trained by {owner}: wait until it ends, or stop it."
            ) from None
        except OSError as error:
            raise MorlaxError(f"cannot lock {self._folder}: {error.strerror or error}.") from None

    def release(self) -> None:
        """Give the lock back, if it is held."""
        if self._lock.is_locked:
            with suppress(OSError):
                self._owner.unlink()
            self._lock.release()
