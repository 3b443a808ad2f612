"""`python -m morlax_torch.evaluate` and `morlax_torch.evaluate.evaluate`, as in version 1.0."""

from .commands.evaluate import main
from .envs.lazy import handed_on, make_callable

__getattr__, __dir__ = handed_on(__name__, {"evaluate": "runs.evaluating"})
make_callable(__name__)

if __name__ == "__main__":
    main()
