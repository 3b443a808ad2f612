"""The built-in tasks, by name, each as the module and the class that define it."""

from . import mo_gymnasium, pgmorl

TASKS = {
    "ant": "ant:Ant",
    "bruce": "bruce:Bruce",
    "cheetah": "cheetah:Cheetah",
    "cheetah3": "cheetah:Cheetah3",
    "hopper": "hopper:Hopper",
    "humanoid": "humanoid:Humanoid",
    "walker": "walker:Walker",
    **pgmorl.TASKS,
    **mo_gymnasium.TASKS,
}
