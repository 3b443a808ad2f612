"""The journal file of a study, which survives a full disk."""

import os
from typing import Any

from ..envs import MorlaxError
from ..files import exists
from .library import optuna

START = b'{"op_code":'  # of every line


class StorageError(MorlaxError):
    """A study cannot be written."""


class Journal(optuna.storages.journal.JournalFileBackend):
    """Optuna's journal file, without the incomplete last line that a full disk leaves.

    Raises:
        StorageError: the file is not a journal, or cannot be written.
    """

    def __init__(self, path: str):
        if exists(path) and not _is_journal(path):
            raise StorageError(
                f"cannot use the storage {path}: it is not a journal of tune. Name a new file, or "
                "a database, such as sqlite:///study.db."
            )
        super().__init__(path, _CuttingLock(path))
        self._path = path

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        try:
            super().append_logs(logs)
        except OSError as error:
            raise StorageError(
                f"cannot write the journal {self._path}: {error.strerror or error}."
            ) from None


class _CuttingLock(optuna.storages.journal.JournalFileSymlinkLock):
    """The lock of a journal; whoever gets it first cuts off an incomplete last line."""

    def __init__(self, path: str):
        super().__init__(path)
        self._path = path

    def acquire(self) -> bool:
        super().acquire()
        try:
            _cut(self._path)
        except BaseException:
            self.release()
            raise
        return True


def _is_journal(path: str) -> bool:
    """Return whether a file is empty, or begins like a journal."""
    with open(path, "rb") as file:
        begin = file.read(len(START))
    return START.startswith(begin)


def _cut(path: str) -> None:
    """Remove what follows the last line break of a file."""
    with open(path, "r+b") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return
        file.seek(-1, os.SEEK_END)
        if file.read() != b"\n":
            file.seek(0)
            file.truncate(file.read().rfind(b"\n") + 1)
