"""`python -m morlax_torch.export` and `morlax_torch.export.export`, as in version 1.0."""

from .commands.export import main
from .envs.lazy import handed_on, make_callable

__getattr__, __dir__ = handed_on(__name__, {"export": "exports.exporting"})
make_callable(__name__)

if __name__ == "__main__":
    main()
