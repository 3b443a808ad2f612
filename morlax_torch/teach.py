"""`python -m morlax_torch.teach` and `morlax_torch.teach.Lesson`, as in version 1.0."""

from .commands.teach import main
from .envs.lazy import handed_on

__getattr__, __dir__ = handed_on(__name__, {"Lesson": "preferences.teaching"})

if __name__ == "__main__":
    main()
