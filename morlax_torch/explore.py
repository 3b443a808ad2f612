"""`python -m morlax_torch.explore` and `morlax_torch.explore.explore`, as in version 1.0."""

from .commands.explore import main
from .envs.lazy import handed_on, make_callable

__getattr__, __dir__ = handed_on(__name__, {"explore": "commands.explore"})
make_callable(__name__)

if __name__ == "__main__":
    main()
