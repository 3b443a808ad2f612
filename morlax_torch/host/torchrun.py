"""What `torchrun` tells the processes that it starts."""

import os

PROCESSES = int(os.environ.get("WORLD_SIZE", "1"))
SEVERAL = PROCESSES > 1
FIRST = not SEVERAL or os.environ.get("RANK") == "0"
LOCAL_RANK = int(os.environ.get("LOCAL_RANK", "0"))  # among those on this host
MAY_RESTART = os.environ.get("TORCHELASTIC_MAX_RESTARTS", "0") != "0"


def launch() -> str:
    """Return the host and process ID of the launcher, which restarts keep; "" without one."""
    if "TORCHELASTIC_RUN_ID" not in os.environ:
        return ""
    import socket  # takes a while, and every command imports this module

    return f"{socket.gethostname()} {os.getppid()}"
