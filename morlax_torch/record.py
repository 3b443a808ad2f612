"""`python -m morlax_torch.record` and `morlax_torch.record.record`, as in version 1.0."""

from .commands.record import main
from .envs.lazy import handed_on, make_callable

__getattr__, __dir__ = handed_on(__name__, {"record": "viewers.filming.recording"})
make_callable(__name__)

if __name__ == "__main__":
    main()
