"""What an objective is made of, in words."""

from inspect import cleandoc

from ...envs.worlds.robot import Robot


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
