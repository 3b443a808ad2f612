"""Write films and film strips."""

from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from rich.progress import track

from ...envs import MorlaxError
from ...files import replacing
from ...networks.policy import Policy
from ...tradeoffs import typical_tradeoffs
from .film import Film
from .video import ENDINGS, write_video


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
    show_progress: bool = False,
) -> None:
    """Write a film (.mp4, .gif) or a film strip (.png), by the suffix of `output`.

    Args:
        policy: as `morlax_torch.load` returns it.
        output: the file.
        tradeoffs: (P, m), one panel each (empty: the corners and the balanced trade-off).
        seconds: simulated time.
        speed: playback speed of a film; 0.5 is slow motion.
        width: of a panel, in pixels.
        height: of a panel, in pixels.
        pictures: number per row of a film strip, evenly spaced in time.
        seed: random seed of the world.
        show_progress: draw a progress bar in the terminal.

    Raises:
        MorlaxError: an unusable number, no OpenGL, no ffmpeg, or `output` cannot be written.
    """
    if output.suffix.lower() not in (*ENDINGS, ".png"):
        raise MorlaxError(f"{output} must end in .mp4 or .gif (a film) or in .png (a film strip).")
    film = Film(
        policy,
        tradeoffs or typical_tradeoffs(len(policy.objectives)).tolist(),
        width,
        height,
        seed,
    )
    if output.suffix.lower() == ".png":
        with replacing(output) as file:
            Image.fromarray(film.strip(seconds, pictures)).save(file, format="PNG")
    else:
        every, fps = film.pace(speed)
        total = film.steps(seconds) // every + 1
        watched = track(film.frames(seconds, every), "filming", total, disable=not show_progress)
        write_video(output, iter(watched), fps)
