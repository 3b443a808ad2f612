"""What `torchrun` tells the processes that it starts."""

import os
import socket

PROCESSES = int(os.environ.get("WORLD_SIZE", "1"))
SEVERAL = PROCESSES > 1
FIRST = not SEVERAL or os.environ.get("RANK") == "0"
LOCAL_RANK = int(os.environ.get("LOCAL_RANK", "0"))  # among those on this host
MAY_RESTART = os.environ.get("TORCHELASTIC_MAX_RESTARTS", "0") != "0"
RESTARTS = int(os.environ.get("TORCHELASTIC_RESTART_COUNT", "0"))  # so far


def launch() -> str:
    """Return what names this start of `torchrun`, also after its restarts; "": it was not used."""
    identity = os.environ.get("TORCHELASTIC_RUN_ID", "")
    return f"{socket.gethostname()} {os.getppid()}" if identity == "none" else identity
