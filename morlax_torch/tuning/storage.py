"""Where Optuna keeps a study: a journal file, or a database."""

import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..envs import MorlaxError
from ..files import exists, is_file, make_folder
from .journal import Journal, StorageError
from .library import optuna

CREATED = ("already exists", "unique constraint", "duplicate key")  # by another process just now
PAUSE = 2.0  # seconds in which it creates the other tables


def open_storage(place: str) -> optuna.storages.BaseStorage:
    """Open a journal file or the database of a URL, such as postgresql://...

    Raises:
        MorlaxError: it cannot be opened or written.
    """
    try:
        if "://" in place:
            return _database(place)
        make_folder(Path(place).parent)
        if exists(place) and not is_file(place):
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
