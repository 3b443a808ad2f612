"""Optional libraries are imported only by their own adapters."""

import importlib
import sys
from importlib import metadata

import pytest
from programs import python
from tiny import TYPED

from morlax_torch import MorlaxError, load

HOSTS = {  # adapter: (its extra, an unsupported version, the oldest supported version)
    "stable_baselines3": ("sb3", "2.6.0", "2.7"),
    "torchrl": ("torchrl", "0.9.2", "0.14"),
    "rsl_rl": ("rsl-rl", "2.3.3", "3.0"),
    "skrl": ("skrl", "1.4.3", "2.0"),
}
TRAIN_TRACKED = """
import sys
import wandb
from morlax_torch.commands import train
with wandb.init(mode="offline", sync_tensorboard=True):
    train.command(sys.argv[1:])
"""


def import_adapter(name: str, monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, f"morlax_torch.adapters.{name}", raising=False)
    importlib.import_module(f"morlax_torch.adapters.{name}")


@pytest.mark.parametrize("name", HOSTS)
def test_errors_name_the_extra_to_install_and_the_required_version(name, monkeypatch):
    def missing(package: str) -> str:
        raise metadata.PackageNotFoundError(package)

    extra, old, least = HOSTS[name]
    monkeypatch.setattr(metadata, "version", missing)
    with pytest.raises(MorlaxError, match=rf"{least} .* none is installed: pip .*\[{extra}\]"):
        import_adapter(name, monkeypatch)
    monkeypatch.setattr(metadata, "version", lambda package: old)
    with pytest.raises(MorlaxError, match=rf"{least} or later is needed, but {old} is installed"):
        import_adapter(name, monkeypatch)


def test_without_mjlab_the_shipped_robots_of_mjlab_name_what_to_install(monkeypatch):
    monkeypatch.setattr(metadata, "version", lambda package: "0.1")
    with pytest.raises(MorlaxError, match=r"^mjlab 1.6 or later is needed, but 0.1 is installed"):
        load("go1")


@pytest.mark.slow
@pytest.mark.long
def test_weights_and_biases_syncs_the_indicators_and_losses(tmp_path):
    pytest.importorskip("wandb")
    words = "--env", "hopper", *TYPED, "--output", "run"
    done = python("-c", TRAIN_TRACKED, *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (log,) = tmp_path.glob("wandb/offline-run-*/*.wandb")
    assert b"front/hypervolume" in log.read_bytes() and b"train/policy_loss" in log.read_bytes()
