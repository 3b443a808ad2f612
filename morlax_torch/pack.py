"""`python -m morlax_torch.pack` and `morlax_torch.pack.pack`, as in version 1.0."""

from .commands.pack import main
from .envs.lazy import handed_on, make_callable

__getattr__, __dir__ = handed_on(__name__, {"pack": "runs.evaluating"})
make_callable(__name__)

if __name__ == "__main__":
    main()
