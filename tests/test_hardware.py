"""A run names the machines that trained it, and the report and TensorBoard show them."""

from pathlib import Path

import pytest
import torch
from tiny import learner, tiny

from morlax_torch import MORLAX, MorlaxError
from morlax_torch.reports.results import facts
from morlax_torch.runs import Run, hardware
from morlax_torch.runs.hardware import Machine, device_name, read_machines

OTHER = Machine(device="NVIDIA H200", cores=16, torch="2.9.0", simulator="MuJoCo Warp 3.4.0")


@pytest.fixture
def trainer() -> MORLAX:
    return learner(tiny())


@pytest.fixture
def folder(trainer, tmp_path) -> Path:
    with Run.create(trainer, tmp_path / "run") as run:
        return run.folder


def restore(folder: Path, trainer: MORLAX) -> list[Machine]:
    with Run.open(folder) as run:
        run.restore(trainer)
    return read_machines(folder)


def test_a_new_run_names_its_machine(folder):
    (machine,) = read_machines(folder)
    assert machine.device == device_name(torch.device("cpu"))
    assert machine.device not in ("", "unknown")
    assert machine.cores == hardware.cores() > 0
    assert machine.torch == torch.__version__
    assert machine.simulator.startswith(("C MuJoCo ", "MuJoCo Warp ")) and machine.processes == 1


def test_a_run_that_is_resumed_elsewhere_names_both_machines_in_order(folder, trainer):
    (here,) = read_machines(folder)
    assert restore(folder, trainer) == [here]
    hardware.write_machines(folder, [OTHER])
    assert restore(folder, trainer) == restore(folder, trainer) == [OTHER, here]
    (folder / hardware.FILE).unlink()  # as in an older run
    assert read_machines(folder) == []
    assert restore(folder, trainer) == [Machine(), here]
    assert Machine().hardware() == "unknown"


def test_a_damaged_record_is_one_sentence(folder, trainer):
    for text in ("machines: []", "machines: 3", "[", "machines: [{cores: x}]"):
        (folder / hardware.FILE).write_text(text)
        with pytest.raises(MorlaxError, match=r"hardware\.yaml"):
            restore(folder, trainer)
        assert (folder / hardware.FILE).read_text() == text


def test_the_name_of_a_cpu_is_its_model(tmp_path, monkeypatch):
    monkeypatch.setattr(hardware, "CPUS", tmp_path / "cpuinfo")
    (tmp_path / "cpuinfo").write_text(
        "processor\t: 0\nmodel name\t: A CPU: fast\nmodel name\t: B\n"
    )
    assert device_name(torch.device("cpu")) == "A CPU: fast"
    (tmp_path / "cpuinfo").unlink()
    monkeypatch.setattr("platform.processor", lambda: "arm")
    assert device_name(torch.device("cpu")) == "arm"


def test_facts_name_each_change_of_hardware_and_software():
    config, measures = tiny(), {"hypervolume": 1.0}
    assert "trained on" not in facts(config, None, measures)
    newer = OTHER.model_copy(update={"torch": "2.10.0"})
    pair = Machine(device="B200", processes=2, cores=1, torch="2.10.0", simulator="mjlab 1.0")
    found = facts(config, None, measures, [OTHER, newer, pair])
    assert found["trained on"] == "NVIDIA H200, 16 CPU cores; then 2 x B200, 1 CPU core"
    assert found["trained with"] == (
        "PyTorch 2.9.0, MuJoCo Warp 3.4.0; then PyTorch 2.10.0, MuJoCo Warp 3.4.0; "
        "then PyTorch 2.10.0, mjlab 1.0"
    )
