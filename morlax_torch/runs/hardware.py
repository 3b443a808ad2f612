"""The machines that trained a run: hardware.yaml in its folder."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch
from pydantic import BaseModel, Field, ValidationError

from ..algorithms.learner import Learner
from ..configuration.files import read_yaml, write_yaml
from ..envs import MorlaxError
from ..envs.errors import explained
from ..host.files import write_file

FILE = "hardware.yaml"
CPUS = Path("/proc/cpuinfo")
PACKAGES = {  # by Worlds.simulator
    "C MuJoCo": "mujoco",
    "MuJoCo Warp": "mujoco-warp",
    "MuJoCo Playground": "playground",
    "gymnasium": "gymnasium",
    "mjlab": "mjlab",
}


class Machine(BaseModel):
    """The hardware and software of one or more sessions of training."""

    device: str = "unknown"
    """Name of the GPU, or of the CPU if it trained."""
    processes: int = Field(default=1, ge=1)
    """How many trained together, each on a device of its own."""
    cores: int | None = None
    """CPU cores that a process may use."""
    torch: str = "unknown"
    simulator: str = "unknown"

    def hardware(self) -> str:
        several = f"{self.processes} x " if self.processes > 1 else ""
        cores = "" if self.cores is None else f", {self.cores} CPU core{'s' * (self.cores > 1)}"
        return f"{several}{self.device}{cores}"

    def software(self) -> str:
        return f"PyTorch {self.torch}, {self.simulator}"


class Machines(BaseModel):
    """The contents of hardware.yaml."""

    machines: list[Machine] = Field(min_length=1)
    """In the order in which they trained the run."""


def this_machine(learner: Learner) -> Machine:
    return Machine(
        device=device_name(learner.env.device),
        processes=learner.group.size,
        cores=cores(),
        torch=torch.__version__,
        simulator=_with_version(learner.env.simulator),
    )


def read_machines(folder: Path) -> list[Machine]:
    """Return the machines that trained a run, in order; none if the run does not name them."""
    path = folder / FILE
    if not path.exists():
        return []
    try:
        return Machines.model_validate(read_yaml(path, "record", "machines: []")).machines
    except ValidationError as error:
        raise MorlaxError(f"{path} is damaged: {explained(error, Machines)}") from None


def write_machines(folder: Path, machines: list[Machine]) -> None:
    write_file(folder / FILE, write_yaml(Machines(machines=machines)))


def resumed(machines: list[Machine], now: Machine) -> list[Machine]:
    """Return the machines of a run, empty if it names none, and the one that continues it."""
    known = machines or [Machine()]
    return known if known[-1] == now else [*known, now]


def device_name(device: torch.device) -> str:
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    try:
        lines = CPUS.read_text(errors="replace").splitlines()
    except OSError:  # not on Linux
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine() or "unknown"


def cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _with_version(simulator: str) -> str:
    try:
        return f"{simulator} {version(PACKAGES.get(simulator, ''))}"
    except (PackageNotFoundError, ValueError):  # of a user's own worlds
        return simulator
