"""Films as files: H.264 for browsers and slides, or an animated GIF."""

import subprocess
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from shutil import which

import numpy as np
from numpy.typing import NDArray

from ...envs import MorlaxError
from ...files import replacing

# H.264 as every browser plays it needs even sizes; a GIF looks well with a palette of its own.
_ENCODERS = {
    ".mp4": (
        *("-f", "mp4", "-codec:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p"),
        *("-movflags", "+faststart", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"),
    ),
    ".gif": ("-f", "gif", "-vf", "split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=none"),
}
ENDINGS = tuple(_ENCODERS)


def write_video(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    """Write frames (H, W, 3), all of one size, as the ending of `path` says: .mp4 or .gif.

    Raises:
        MorlaxError: there is no ffmpeg, it refuses, or `path` cannot be written.
    """
    ffmpeg = find_ffmpeg()
    rate = str(Fraction(fps).limit_denominator(1000))
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
            with suppress(BrokenPipeError):  # then it says itself what is wrong
                process.stdin.write(first.tobytes())
                for frame in frames:
                    process.stdin.write(frame.tobytes())
            _, words = process.communicate()
        if process.returncode:
            reason = words.decode(errors="replace").strip().splitlines() or ["ffmpeg failed"]
            raise MorlaxError(f"cannot write {path}: {reason[-1].rstrip('.')}.")


def find_ffmpeg() -> str:
    """The path of ffmpeg, which imageio-ffmpeg brings along.

    Raises:
        MorlaxError: there is none.
    """
    try:
        import imageio_ffmpeg
    except ImportError:
        raise MorlaxError(
            "writing a film takes ffmpeg: pip install 'morlax-torch[video]' (a film strip, "
            "--output FILE.png, does without)."
        ) from None
    # None, or a RuntimeError, where IMAGEIO_FFMPEG_EXE names nothing and where no wheel had one
    with suppress(RuntimeError):
        if found := which(imageio_ffmpeg.get_ffmpeg_exe()):
            return found
    raise MorlaxError("there is no ffmpeg: install it, or set IMAGEIO_FFMPEG_EXE to where it is.")
