"""The library of gaits as it is planned, stored in one small file of the package."""

from dataclasses import asdict, dataclass, fields
from importlib import resources
from typing import IO, Self

import numpy as np
from numpy.typing import NDArray

FORWARD = np.linspace(-0.2, 0.2, 17).round(3)  # m/s
SIDEWAYS = np.linspace(-0.1, 0.1, 9).round(3)  # m/s


@dataclass(frozen=True)
class Constants:
    """Parameters of the gaits, in meters and seconds."""

    step_time: float = 0.4
    width: float = 0.2
    """Lateral distance between the feet when walking straight."""
    com_height: float = 0.385
    """Height of the center of mass above the soles."""
    apex: float = 0.035
    """Largest height of the swing sole above the floor."""
    pivot: float = -0.005
    """Desired center of pressure, forward of the sole's center: 10 mm behind the box's center."""
    rounds: int = 4
    """Number of corrections of the center of mass."""


@dataclass(frozen=True)
class Gait:
    """Two steps that repeat, each a Bezier curve."""

    joints: NDArray[np.float64]  # (2, 8, 16) control points in crank coordinates
    base: NDArray[np.float64]  # (2, 8, 6) position and roll, pitch, yaw, in the stance sole's frame


@dataclass(frozen=True)
class Library:
    """A gait for each velocity of a grid, with X velocities forward and Y sideways."""

    vx: NDArray[np.float64]  # (X,) m/s
    vy: NDArray[np.float64]  # (Y,) m/s
    joints: NDArray[np.float32]  # (X, Y, 2, 8, 16) control points, as in `Gait`
    base: NDArray[np.float32]  # (X, Y, 2, 8, 6)
    walked: NDArray[np.int64]  # (X, Y) steps walked in simulation before falling, at most 25
    measured: dict[str, NDArray[np.float64]]  # (X, Y) each, by the planner's limit
    constants: Constants  # of the planner

    def gait(self, i: int, j: int) -> Gait:
        """Return the gait for `vx[i]`, `vy[j]`."""
        return Gait(self.joints[i, j].astype(float), self.base[i, j].astype(float))

    def save(self, file: IO[bytes]) -> None:
        """Write the library as .npz."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        measured = {f"measured.{name}": values for name, values in self.measured.items()}
        constants = {f"constants.{name}": value for name, value in asdict(self.constants).items()}
        np.savez_compressed(file, **arrays, **measured, **constants)

    @classmethod
    def load(cls) -> Self:
        """Load the library of the package."""
        with (resources.files("morlax_torch.envs.robots.bruce") / "gaits.npz").open("rb") as file:
            contents = dict(np.load(file))

        def group(prefix: str) -> dict[str, NDArray]:
            return {
                name.removeprefix(prefix): value
                for name, value in contents.items()
                if name.startswith(prefix)
            }

        constants = Constants(**{k: v.item() for k, v in group("constants.").items()})
        arrays = {name: contents[name] for name in _ARRAYS}
        return cls(**arrays, measured=group("measured."), constants=constants)


_ARRAYS = tuple(f.name for f in fields(Library) if f.name not in ("measured", "constants"))
