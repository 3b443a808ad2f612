"""`python -m morlax_torch.tune` and `morlax_torch.tune.tune`, as in version 1.0."""

from .commands.tune import main
from .envs.lazy import handed_on, make_callable

__getattr__, __dir__ = handed_on(__name__, {"tune": "tuning.searching"})
make_callable(__name__)

if __name__ == "__main__":
    main()
