"""Where Optuna keeps a study: a journal file that survives a full disk, or a database."""

import os
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..envs import MorlaxError
from ..envs.errors import installation
from ..host.files import make_folder

try:
    import optuna
except ImportError as error:
    raise MorlaxError(
        f"tuning needs {error.name}, which is not installed: {installation('tune')}."
    ) from None


START = b'{"op_code":'  # of every line
CREATED = ("already exists", "unique constraint", "duplicate key")  # by another process just now
PAUSE = 2.0  # seconds in which it creates the other tables


class StorageError(MorlaxError):
    """A study cannot be written."""


class Journal(optuna.storages.journal.JournalFileBackend):
    """Optuna's journal file, without the incomplete last line that a full disk leaves."""

    def __init__(self, path: str):
        if Path(path).exists() and not _is_journal(path):
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


def open_storage(place: str) -> optuna.storages.BaseStorage:
    """Open a journal file, or the database of a URL, such as postgresql://..."""
    try:
        if "://" in place:
            return _database(place)
        make_folder(Path(place).parent)
        if Path(place).exists() and not Path(place).is_file():
            raise MorlaxError(f"cannot use the storage {place}: it is not a regular file.")
        return optuna.storages.JournalStorage(Journal(place))
    except MorlaxError:
        raise
    except Exception as error:  # each database and driver fails in its own way
        raise unusable(place, error) from None


def unusable(place: str, error: BaseException) -> StorageError:
    """Return the error of a storage that cannot be opened or written."""
    reason = getattr(error, "strerror", None) or str(error).split("\n")[0]
    return StorageError(f"cannot use the storage {place}: {' '.join(reason.split()).rstrip('.')}.")


def _database(url: str) -> optuna.storages.BaseStorage:
    try:
        return optuna.storages.RDBStorage(url)
    except Exception as error:  # each driver has its own
        if not any(words in str(error).lower() for words in CREATED):
            raise
    time.sleep(PAUSE)
    return optuna.storages.RDBStorage(url)


@contextmanager
def quiet() -> Iterator[None]:
    """Silence Optuna's log and its warnings about experimental features."""
    usual = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            yield
    finally:
        optuna.logging.set_verbosity(usual)
