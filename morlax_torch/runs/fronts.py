"""Load the front of the checkpoint that `load` loads."""

import shlex
from pathlib import Path

from ..configuration.sections import EvaluationConfig
from ..envs import MorlaxError
from ..evaluation.front import Front
from ..host.files import AnyPath
from . import checkpoint
from .loading import find_checkpoint


def load_front(run: AnyPath) -> Front:
    """Load the front of the policies that `load` loads.

    The front's `checkpoint` names the file whose policies reached its returns, such as "best.pt".

    Args:
        run: a run's folder, a checkpoint file, or a shipped name.

    Raises:
        MorlaxError: there is no such run, it has no front, the front is damaged, is of another
            checkpoint, or counts returns by another protocol than the run.
    """
    path = find_checkpoint(run)
    file = checkpoint.front_path(path)
    if not file.is_file():
        raise MorlaxError(f"{path} has no front beside it: {_remedy(path)}")
    front, contents = Front.load(file), checkpoint.load(path)
    if front.objectives != contents.environment.objectives:
        raise MorlaxError(f"{file} has other objectives than {path}: {_remedy(path)}")
    usual = EvaluationConfig().protocol  # of a config that does not name it
    own = contents.config.get("evaluation", {}).get("protocol", usual)
    if front.protocol != own:
        raise MorlaxError(
            f"{file} counts returns by the protocol {front.protocol}, but {path} by {own}: "
            f"{_remedy(path)}"
        )
    if front.fingerprint != checkpoint.fingerprint(contents.agent):
        raise MorlaxError(f"{file} is of other policies than {path}: {_remedy(path)}")
    return front._replace(checkpoint=path.name)


def _remedy(path: Path) -> str:
    """Return the command that writes the front of a checkpoint, as the end of a sentence."""
    best = path.name == "best.pt" and path.parent.name == "checkpoints"
    named = checkpoint.folder_of(path) if best else path
    return f"write it with morlax evaluate {shlex.quote(str(named))}"
