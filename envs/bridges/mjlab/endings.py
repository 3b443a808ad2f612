"""How episodes of mjlab end: what worlds show before they restart within a step."""

from functools import cache
from importlib import import_module
from typing import Any

from torch import Tensor

from ..foreign import ACTORS, CRITIC

ENDINGS = "endings"  # mjlab's name of the recorder
BLOWN_UP = "blown_up"  # of the termination


def watch_endings(cfg: Any) -> None:
    """Let worlds of this config show how episodes end, and terminate if they are not finite."""
    termination = import_module("mjlab.managers").TerminationTermCfg
    cfg.terminations[BLOWN_UP] = termination(func=_not_finite)
    if cfg.auto_reset:
        recorders = import_module("mjlab.managers.recorder_manager")
        cfg.recorders[ENDINGS] = recorders.RecorderTermCfg(func=_recorder())


def take_ending(env: Any) -> dict[str, Tensor] | None:
    """Return the observations before the restarts of the last step, if there were any."""
    recorder = env.recorder_manager.get_term(ENDINGS)
    groups, recorder.groups = recorder.groups, None
    return groups


def _not_finite(env: Any) -> Tensor:
    found: Tensor = import_module("mjlab.envs.mdp").nan_detection(env)
    return found | ~env.action_manager.action.isfinite().all(1)


@cache
def _recorder() -> type:
    """Return mjlab's kind of recorder, which sees all worlds just before some restart."""
    base = import_module("mjlab.managers.recorder_manager").RecorderTerm

    class Endings(base):
        groups: dict[str, Tensor] | None = None

        def record_pre_reset(self, env_ids: Tensor) -> None:
            manager = self._env.observation_manager
            used = {*ACTORS, CRITIC} & set(manager.active_terms)
            self.groups = {name: manager.compute_group(name) for name in used}

    return Endings
