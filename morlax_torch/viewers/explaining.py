"""What the page says of a task: what objectives are made of, and what its command means."""

from inspect import cleandoc

from ..envs.worlds.mujoco_robot import Robot

VELOCITIES = ("m/s", "lin_vel")  # how names of commanded velocities begin


def is_told_velocity(env: Robot) -> bool:
    """Whether the command begins with velocities in m/s, forward and to the left."""
    names = list(env.command_limits)[:2]
    return len(names) == 2 and all(name.startswith(VELOCITIES) for name in names)


def explain(env: Robot, objective: str) -> str:
    """Return an objective's weighted reward terms, and their docstrings.

    A term's docstring is that of the task's method of the same name, such as `energy`. Objectives
    that come from no such options, as in foreign tasks, have only their name.
    """
    options = getattr(env, "options", None)
    terms = getattr(options, "objectives", {}).get(objective)
    if not terms:
        return f"Weight of {objective}."
    shared = getattr(options, "shared", {})
    parts = [f"{weight:g} * {term}" for term, weight in terms.items()]
    text = f"{objective} = {' + '.join(parts)}".replace("+ -", "- ")
    if shared:
        names = " + ".join(f"{weight:g} * {term}" for term, weight in shared.items())
        text += f". Every objective also gets {names}".replace("+ -", "- ")
    notes = [f"{term}: {note}" for term in terms if (note := _docstring(env, term))]
    return ". ".join([text, *notes]).rstrip(".") + "."


def _docstring(env: Robot, term: str) -> str:
    """Return the first line of what a task says about one of its reward terms."""
    method = getattr(type(env), term.replace(" ", "_"), None)
    if not callable(method) or hasattr(Robot, term) or not method.__doc__:
        return ""
    return cleandoc(method.__doc__).splitlines()[0].rstrip(".")
