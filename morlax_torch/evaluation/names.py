"""Names of a policy's values: returns by objective, then measured quantities."""

from typing import NamedTuple

from ..envs import MorlaxError
from ..envs.errors import unknown


class Names(NamedTuple):
    """Names of the values (m + q,) of a policy, in their order."""

    objectives: tuple[str, ...]  # m
    quantities: tuple[str, ...]  # q, with units, such as "power (W)"
    measured_in: str = "this front"  # the task or the like, for messages

    @property
    def all(self) -> tuple[str, ...]:
        return (*self.objectives, *self.quantities)

    def index(self, name: str) -> int:
        """Return the index of a value; a quantity may be named without its unit.

        Raises:
            MorlaxError: there is no such value, or more than one.
        """
        if name in self.all:
            return self.all.index(name)
        found = [full for full in self.quantities if full.partition(" (")[0] == name]
        if len(found) == 1:
            return self.all.index(found[0])
        if found:
            raise MorlaxError(f"{name!r} is ambiguous: write {' or '.join(map(repr, found))}.")
        if self.quantities:
            raise unknown("objective or quantity", name, self.all)
        error = unknown("objective", name, self.objectives)
        raise MorlaxError(f"{error} No quantities are measured in {self.measured_in}.")
