"""Write films and film strips: H.264 for browsers and slides, animated GIF, or PNG."""

from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...configuration.tradeoffs import typical_tradeoffs
from ...envs import MorlaxError
from ...evaluation.front import Front
from ...host.files import replacing
from ...host.phases import phase
from ...networks.policy import Policy
from .film import Film
from .sweep import Sweep
from .video import ENDINGS, FASTEST, write_video


def record(
    policy: Policy,
    output: Path,
    tradeoffs: Sequence[Sequence[float]] = (),
    seconds: float = 5.0,
    speed: float = 1.0,
    width: int = 480,
    height: int = 360,
    pictures: int = 8,
    seed: int = 0,
    sweep: Front | None = None,
    bodies: Sequence[Mapping[str, float]] = (),
) -> None:
    """Write a film (.mp4, .gif) or a film strip (.png), by the suffix of `output`.

    Args:
        policy: as `morlax_torch.load` returns it.
        output: the file.
        tradeoffs: (P, m), one panel each (empty: the corners and the balanced trade-off).
        seconds: simulated time; a film strip shows the end of it.
        speed: playback speed of a film; 0.5 is slow motion.
        width: of a panel, in pixels.
        height: of a panel, in pixels.
        pictures: number per row of a film strip, evenly spaced over one or two gait cycles.
        seed: random seed of the world.
        bodies: design parameters of each body to show, by name, each with every trade-off (empty:
            the body of the policy). Then the default is the balanced trade-off.
        sweep: film one robot instead, whose trade-off moves along this front of the policy.

    Raises:
        MorlaxError: an unusable number, no OpenGL, no ffmpeg, or `output` cannot be written.
    """
    if output.suffix.lower() not in (*ENDINGS, ".png"):
        raise MorlaxError(f"{output} must end in .mp4 or .gif (a film) or in .png (a film strip).")
    if sweep is not None and (tradeoffs or bodies or output.suffix.lower() == ".png"):
        raise MorlaxError(
            "a sweep is a film (.mp4 or .gif) of all trade-offs of one body: name none of them."
        )
    if sweep is None:
        m = len(policy.objectives)
        shown = tradeoffs or ([[1 / m] * m] if bodies else typical_tradeoffs(m).tolist())
        film = Film(policy, shown, width, height, seed, bodies)
    else:
        film = Sweep(policy, sweep, width, height, seed)
    if output.suffix.lower() == ".png":
        with replacing(output) as file:
            Image.fromarray(film.strip(seconds, pictures)).save(file, format="PNG")
    else:
        every, fps = film.pace(speed, FASTEST[output.suffix.lower()])
        total = film.steps(seconds) // every + 1
        write_video(output, _counted(film.frames(seconds, every), total), fps)


def strip(policy: Policy, tradeoff: Sequence[float]) -> bytes | None:
    """Return a small film strip of a policy on the CPU as PNG; None if it cannot be drawn here."""
    try:
        drawn = Film(policy, [tradeoff], width=240, height=180).strip()
    except MorlaxError:  # no OpenGL, or no MuJoCo robot
        return None
    file = BytesIO()
    Image.fromarray(drawn).save(file, format="PNG")
    return file.getvalue()


def _counted(frames: Iterator[NDArray[np.uint8]], total: int) -> Iterator[NDArray[np.uint8]]:
    """Yield frames, at most `total` of them, and tell how many there have been."""
    for number, frame in enumerate(frames):
        phase("filming", number / total)
        yield frame
