"""Write video files: H.264 for browsers and slides, or animated GIF."""

import subprocess
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from shutil import which

import numpy as np
from numpy.typing import NDArray

from ...envs import MorlaxError
from ...envs.errors import installation
from ...host.files import replacing

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


def write_video(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    """Write frames (H, W, 3) RGB of one size as a video; the suffix selects .mp4 or .gif.

    Raises:
        MorlaxError: ffmpeg is missing or fails, or `path` cannot be written.
    """
    ffmpeg = find_ffmpeg()
    rate = str(Fraction(fps).limit_denominator(1000))
    if path.suffix.lower() == ".gif":
        frames = _steady(frames)
    with replacing(path) as file:
        first = next(frames)
        height, width, _ = first.shape
        command = [
            *(ffmpeg, "-v", "error", "-y"),
            *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", rate),
            *("-i", "-", *_ENCODERS[path.suffix.lower()], file.name),
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
        if found := which(imageio_ffmpeg.get_ffmpeg_exe()):
            return found
    raise MorlaxError("ffmpeg is missing: install it, or set IMAGEIO_FFMPEG_EXE to its path.")
