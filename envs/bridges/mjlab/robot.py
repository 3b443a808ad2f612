"""One robot of a task of mjlab, to look at."""

from functools import cache
from typing import Any

import mujoco
import torch
from torch import Tensor

from ...worlds.mujoco_robot import Deployment, Part, Robot
from .deployment import deployment_of
from .worlds import MjlabWorlds, from_task


@cache
def robot_of(name: str) -> type["MjlabRobot"]:
    """Return the class of one robot of "mjlab:TASK"."""
    return type("MjlabRobot", (MjlabRobot, from_task(name)), {})


class MjlabRobot(MjlabWorlds, Robot):
    """Worlds of mjlab on the CPU whose command stays as it is until someone changes it."""

    def _open(self, seed: int) -> None:
        super()._open(seed)
        self.physics = _MjlabState(self.env.sim, self.env.cfg.viewer.distance)
        self.command_limits = {}
        for name, term in self.env.cfg.commands.items():
            ranges = getattr(term, "ranges", None)
            given = {} if ranges is None else vars(ranges)
            limits = {key: value for key, value in given.items() if key != "heading"}
            command = self.env.command_manager.get_command(name)
            if len(limits) == command.shape[1]:
                self.command_limits, self.command = limits, command

    def config(self, seed: int) -> Any:
        cfg = super().config(seed)
        for term in cfg.commands.values():
            term.resampling_time_range = (1e9, 1e9)
            for share in ("rel_standing_envs", "rel_heading_envs", "rel_world_envs"):
                if hasattr(term, share):
                    setattr(term, share, -1.0)  # below what is drawn, so that no world has it
        return cfg

    def layout(self) -> list[Part]:
        manager = self.env.observation_manager
        names = manager.active_terms[self.actor_group]
        sizes = manager.group_obs_term_dim[self.actor_group]
        return [
            Part(name, torch.Size(size).numel(), "as in mjlab")
            for name, size in zip(names, sizes, strict=True)
        ]

    def targets(self) -> list[str]:
        return [name for term in self._actions() for name in term.target_names]

    def scales(self) -> tuple[list[float], list[float]] | None:
        if not all(type(term).__name__ == "JointPositionAction" for term in self._actions()):
            return None
        each = [torch.ones(term.action_dim, dtype=torch.float32) for term in self._actions()]
        scale = [one * term.scale for one, term in zip(each, self._actions(), strict=True)]
        offset = [one * term.offset for one, term in zip(each, self._actions(), strict=True)]
        size = self.options.action_scale
        return (
            (size * torch.cat([rows.view(-1) for rows in scale])).tolist(),
            torch.cat([rows.view(-1) for rows in offset]).tolist(),
        )

    def deployment(self) -> Deployment | None:
        scales = self.scales()
        if scales is None:
            return None
        scale, offset = scales
        return deployment_of(
            self.env,
            self.actor_group,
            {"scale": scale, "offset": offset},
            self.options.action_scale,
            self.command_limits,
        )

    def _actions(self) -> list[Any]:
        manager = self.env.action_manager
        return [manager.get_term(name) for name in manager.active_terms]


class _MjlabState:
    """mjlab's simulation as a `State`."""

    def __init__(self, sim: Any, distance: float):
        self.model: mujoco.MjModel = sim.mj_model
        self.model.stat.extent = distance / 2  # cameras stand two extents away
        self.qpos: Tensor = sim.data.qpos[:]
        self.qvel: Tensor = sim.data.qvel[:]
        self.ctrl: Tensor = sim.data.ctrl[:]
        self.act: Tensor = sim.data.act[:]
