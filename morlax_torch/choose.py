"""`python -m morlax_torch.choose` and `morlax_torch.choose.choose`, as in version 1.0."""

from .commands.choose import main
from .envs.lazy import handed_on, make_callable

__getattr__, __dir__ = handed_on(__name__, {"choose": "runs.choosing"})
make_callable(__name__)

if __name__ == "__main__":
    main()
