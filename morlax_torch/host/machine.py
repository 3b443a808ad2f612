"""The GPU of this machine, found without torch, whose import takes seconds."""

import ctypes
import os
from contextlib import suppress

CUDA = "nvcuda" if os.name == "nt" else "libcuda.so.1"  # the driver's library


def gpu() -> str | None:
    """Return the name of the first GPU that CUDA may use, or None without a GPU."""
    with suppress(OSError):
        driver, name = ctypes.CDLL(CUDA), ctypes.create_string_buffer(100)
        if not driver.cuInit(0) and not driver.cuDeviceGetName(name, len(name), 0):
            return name.value.decode(errors="replace")
    return None
