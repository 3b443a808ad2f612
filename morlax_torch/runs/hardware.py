"""The machines that trained a run: hardware.yaml in its folder."""

import os
import platform
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch
from pydantic import BaseModel, Field

from ..algorithms.learner import Learner
from ..configuration.files import read_yaml, write_yaml
from ..envs.errors import validated
from ..host.files import write_file

FILE = "hardware.yaml"
CPUS = Path("/proc/cpuinfo")
# by `Worlds.simulator`; others have the simulator's name
PACKAGES = {"C MuJoCo": "mujoco", "MuJoCo Warp": "mujoco-warp"}


class Machine(BaseModel):
    """The hardware and software of one or more sessions of training."""

    device: str  # name of the GPU, or of the CPU if it trained
    processes: int = Field(default=1, ge=1)  # that trained together, each on its own device
    cores: int  # of the CPU, that a process may use
    torch: str
    simulator: str

    @classmethod
    def of(cls, learner: Learner) -> "Machine":
        simulator = learner.env.simulator
        with suppress(PackageNotFoundError, ValueError):  # of a user's own worlds
            simulator = f"{simulator} {version(PACKAGES.get(simulator, simulator))}"
        limited = hasattr(os, "sched_getaffinity")  # some systems cannot limit a process
        cores = len(os.sched_getaffinity(0)) if limited else os.cpu_count() or 1
        return cls(
            device=device_name(learner.env.device),
            processes=learner.group.size,
            cores=cores,
            torch=torch.__version__,
            simulator=simulator,
        )

    def hardware(self) -> str:
        several = f"{self.processes} x " if self.processes > 1 else ""
        return f"{several}{self.device}, {self.cores} CPU core{'s' * (self.cores > 1)}"

    def software(self) -> str:
        return f"PyTorch {self.torch}, {self.simulator}"


class _Machines(BaseModel):
    machines: list[Machine] = Field(min_length=1)


def read_machines(folder: Path) -> list[Machine]:
    """Return the machines that trained a run, in order; none if the run does not name them."""
    path = folder / FILE
    if not path.exists():
        return []
    values = read_yaml(path, "record", "machines: []")
    return validated(_Machines, values, f"{path} is damaged: ").machines


def write_machines(folder: Path, machines: list[Machine]) -> None:
    write_file(folder / FILE, write_yaml(_Machines(machines=machines)))


def device_name(device: torch.device) -> str:
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    with suppress(OSError):  # there is no such file on other systems than Linux
        for line in CPUS.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
