"""A run names the machines that trained it, and the report and TensorBoard show them."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from tiny import learner, tiny

from morlax_torch import MORLAX, MorlaxError
from morlax_torch.host.resources import memory_of
from morlax_torch.reports.comparison import Evaluated
from morlax_torch.reports.page import facts
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
    assert machine.cores > 0
    assert machine.torch == torch.__version__
    assert machine.simulator.startswith(("C MuJoCo ", "MuJoCo Warp ")) and machine.processes == 1


def test_a_run_that_is_resumed_elsewhere_names_both_machines_in_order(folder, trainer):
    (here,) = read_machines(folder)
    assert restore(folder, trainer) == [here]
    hardware.write_machines(folder, [OTHER])
    assert restore(folder, trainer) == restore(folder, trainer) == [OTHER, here]
    (folder / hardware.FILE).unlink()
    assert read_machines(folder) == []
    assert restore(folder, trainer) == [here]


def test_a_damaged_record_is_one_sentence(folder, trainer):
    for text in ("machines: []", "machines: 3", "[", "machines: [{cores: x}]"):
        (folder / hardware.FILE).write_text(text)
        with pytest.raises(MorlaxError, match=r"hardware\.yaml"):
            restore(folder, trainer)
        assert (folder / hardware.FILE).read_text() == text


def test_facts_name_each_change_of_hardware_and_software():
    policy, front = SimpleNamespace(config=tiny()), SimpleNamespace(checkpoint="best.pt")
    run = Evaluated("", policy, front, None, {"hypervolume": 1.0})
    assert "trained on" not in facts(run)
    newer = OTHER.model_copy(update={"torch": "2.10.0"})
    pair = Machine(device="B200", processes=2, cores=1, torch="2.10.0", simulator="mjlab 1.0")
    found = facts(run._replace(machines=[OTHER, newer, pair]))
    assert found["trained on"] == "NVIDIA H200, 16 CPU cores; then 2 x B200, 1 CPU core"
    assert found["trained with"] == (
        "PyTorch 2.9.0, MuJoCo Warp 3.4.0; then PyTorch 2.10.0, MuJoCo Warp 3.4.0; "
        "then PyTorch 2.10.0, mjlab 1.0"
    )


CPU, GIB, UNLIMITED = torch.device("cpu"), 2**30, 9223372036854771712
LIMITS = {  # what files say -> GiB that a process may still take
    "version 2": (
        {"memory.max": 3 * GIB, "memory.current": 2 * GIB, "memory.stat": f"inactive_file {GIB}"},
        2,
    ),
    "version 2, of a parent": (
        {
            "a/b/memory.max": "max",
            "a/memory.max": 3 * GIB,
            "a/memory.current": GIB,
            "memory.max": 4 * GIB,
            "memory.current": GIB,
        },
        2,
    ),
    "version 1": (
        {
            "memory/a/b/memory.limit_in_bytes": 3 * GIB,
            "memory/a/b/memory.usage_in_bytes": 2 * GIB,
            "memory/a/b/memory.stat": f"inactive_file 1\ntotal_inactive_file {GIB // 2}",
            "memory/memory.limit_in_bytes": UNLIMITED,
            "memory/memory.usage_in_bytes": GIB,
        },
        1.5,
    ),
    "no limit": ({"memory.max": "max", "memory.current": GIB}, None),
    "no control groups": ({}, None),
}


@pytest.mark.skipif(not hasattr(os, "sysconf"), reason="Windows")
@pytest.mark.parametrize("which", LIMITS)
def test_the_memory_of_a_container_is_what_its_limit_leaves(which, tmp_path):
    files, expected = LIMITS[which]
    contents = {f"sys/fs/cgroup/{name}": text for name, text in files.items()}
    version = "5:cpu,memory:/a/b\n0::/" if "memory/" in "".join(files) else "0::/a/b"
    for name, text in {"proc/self/cgroup": version, **contents}.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n")
    whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert memory_of(CPU, tmp_path) == (whole if expected is None else expected * GIB)
    assert memory_of(CPU, tmp_path / "elsewhere") == whole
    assert 0 < memory_of(CPU) <= whole
