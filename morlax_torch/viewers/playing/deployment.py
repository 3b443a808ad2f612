"""Open an export: deploy.yaml, the model of the robot, and the policy's file."""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import mujoco
import yaml
from pydantic import ValidationError

from ...envs import MorlaxError
from ...envs.errors import explained
from ...exports.deployment import SETTINGS
from ...host.files import read
from .settings import Settings


@dataclass
class Export:
    """An export that can be played."""

    settings: Settings
    model: mujoco.MjModel
    policy: Path


def open_export(path: Path) -> Export:
    """Open an export by its folder or the file of its policy.

    Raises:
        MorlaxError: a file is missing or damaged, or gains or the command are not known.
    """
    folder = path if path.is_dir() else path.parent
    if not path.exists():
        raise MorlaxError(f"there is no export {path}: morlax export writes one.")
    if not (folder / SETTINGS).exists():
        raise MorlaxError(
            f"{folder} has no {SETTINGS}: morlax export writes one for policies whose actions are "
            "positions of joints, such as those of mjlab's velocity tasks."
        )
    try:
        settings = Settings.model_validate(yaml.safe_load(read(folder / SETTINGS).decode()))
    except ValidationError as error:
        raise MorlaxError(f"{folder / SETTINGS}: {explained(error, Settings)}") from None
    except (ValueError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise MorlaxError(f"{folder / SETTINGS} is not valid YAML: {reason}.") from None
    own = settings.morlax_torch
    if own.model is None:
        raise MorlaxError(f"{folder / SETTINGS} names no model, since its scene cannot be written.")
    policy = folder / own.policy if path == folder else path
    return Export(settings, _model(folder / own.model), policy)


def _model(archive: Path) -> mujoco.MjModel:
    """Compile the model in a zip of an XML file and the files that it names."""
    try:
        with zipfile.ZipFile(io.BytesIO(read(archive, "model"))) as files:
            contents = {name: files.read(name) for name in files.namelist()}
        (name,) = (name for name in contents if name.endswith(".xml"))
        text = contents.pop(name).decode()
        return mujoco.MjSpec.from_string(text, assets=contents).compile()
    except (ValueError, zipfile.BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise MorlaxError(f"cannot load the model {archive}: {reason}.") from None
