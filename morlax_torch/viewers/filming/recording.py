"""Write films and film strips: H.264 for browsers and slides, animated GIF, or PNG."""

import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from shutil import which

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...configuration.tradeoffs import typical_tradeoffs
from ...envs import MorlaxError
from ...envs.errors import installation
from ...evaluation.front import Front
from ...host.files import replacing
from ...host.phases import phase
from ...networks.policy import Policy
from .film import Film, Sweep

# The H.264 that every browser plays needs even sizes; a GIF looks better with its own palette.
_ENCODERS = {
    ".mp4": (
        *("-f", "mp4", "-codec:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p"),
        *("-movflags", "+faststart", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"),
    ),
    ".gif": (
        *("-f", "gif", "-vf"),
        "split[a][b];[a]palettegen=max_colors=96[p];[b][p]paletteuse=dither=none",
    ),
}
FASTEST = {".mp4": 30.0, ".gif": 20.0}  # frames per second, at most
UNSEEN = 3  # of 255: a smaller change of a pixel is left out of a GIF, which then compresses better
ENDINGS = tuple(_ENCODERS)


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
    ending = output.suffix.lower()
    if ending not in (*ENDINGS, ".png"):
        raise MorlaxError(f"{output} must end in .mp4 or .gif (a film) or in .png (a film strip).")
    if sweep is None:
        m = len(policy.objectives)
        shown = tradeoffs or ([[1 / m] * m] if bodies else typical_tradeoffs(m).tolist())
        film = Film(policy, shown, width, height, seed, bodies)
    elif tradeoffs or bodies or ending == ".png":
        raise MorlaxError(
            "a sweep is a film (.mp4 or .gif) of all trade-offs of one body: name none of them."
        )
    else:
        film = Sweep(policy, sweep, width, height, seed)
    if ending == ".png":
        with replacing(output) as file:
            Image.fromarray(film.strip(seconds, pictures)).save(file, format="PNG")
    else:
        stride, fps = film.pace(speed, FASTEST[ending])
        total = film.steps(seconds) // stride + 1

        def frames() -> Iterator[NDArray[np.uint8]]:
            for number, frame in enumerate(film.frames(seconds, stride)):
                phase("filming", number / total)
                yield frame

        write_video(output, frames(), fps)


def strip(policy: Policy, tradeoff: Sequence[float]) -> bytes | None:
    """Return a small film strip of a policy on the CPU as PNG; None if it cannot be drawn here."""
    try:
        drawn = Film(policy, [tradeoff], width=240, height=180).strip()
    except MorlaxError:  # no OpenGL, or no MuJoCo robot
        return None
    file = BytesIO()
    Image.fromarray(drawn).save(file, format="PNG")
    return file.getvalue()


def write_video(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    """Write frames (H, W, 3) RGB of one size as a video; the suffix selects .mp4 or .gif."""
    ffmpeg, ending = find_ffmpeg(), path.suffix.lower()
    rate = str(Fraction(fps).limit_denominator(1000))
    if ending == ".gif":
        frames = _steady(frames)
    with replacing(path) as file:
        first = next(frames)
        height, width, _ = first.shape
        command = [
            *(ffmpeg, "-v", "error", "-y"),
            *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", rate),
            *("-i", "-", *_ENCODERS[ending], file.name),
        ]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stderr=pipe) as process:
            assert process.stdin is not None
            with suppress(BrokenPipeError):  # ffmpeg failed; its stderr has the reason
                process.stdin.write(first.tobytes())
                for frame in frames:
                    process.stdin.write(frame.tobytes())
            _, message = process.communicate()
        if process.returncode:
            reason = message.decode(errors="replace").strip().splitlines() or ["ffmpeg failed"]
            raise MorlaxError(f"cannot write {path}: {reason[-1].rstrip('.')}.")


def _steady(frames: Iterator[NDArray[np.uint8]]) -> Iterator[NDArray[np.uint8]]:
    """Let pixels keep their color until it changes visibly."""
    shown = None
    for frame in frames:
        if shown is not None:
            change = np.abs(frame.astype(np.int16) - shown).max(-1, keepdims=True)
            frame = np.where(change <= UNSEEN, shown, frame)
        shown = frame
        yield frame


def find_ffmpeg() -> str:
    """Return the path of ffmpeg, which imageio-ffmpeg includes, or raise MorlaxError."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise MorlaxError(
            f"writing a film needs ffmpeg: {installation('video')}, or write a film strip "
            "with --output FILE.png."
        ) from None
    # which() is None if IMAGEIO_FFMPEG_EXE is wrong; RuntimeError if the wheel has no ffmpeg
    with suppress(RuntimeError):
        if program := which(imageio_ffmpeg.get_ffmpeg_exe()):
            return program
    raise MorlaxError("ffmpeg is missing: install it, or set IMAGEIO_FFMPEG_EXE to its path.")
