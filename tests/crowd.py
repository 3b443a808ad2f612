"""A robot in a scene where a ball, which stands first in the MJCF, and a door move too."""

import mujoco
import torch
from torch import Tensor

from morlax_torch import envs

BALL, DOOR, ROBOT = 1, 2, 3  # bodies
SCENE = """<mujoco><worldbody><geom type="plane" size="9 9 .1"/>
<body name="ball" pos="9 0 .1"><freejoint/><geom type="sphere" size=".1" mass=".5"/></body>
<body name="door" pos="-9 0 1"><joint name="door" axis="0 0 1"/><geom type="box" size=".5 .1 1"/>
</body>
<body name="robot" pos="0 0 .3"><freejoint/><geom type="box" size=".1 .1 .1" mass="3"/>
<body name="arm" pos=".1 0 0"><joint name="arm" axis="0 1 0" range="-60 60"/><site name="hand"/>
<geom type="capsule" size=".02" fromto="0 0 0 .2 0 -.1" mass=".2"/></body></body></worldbody>
<tendon><fixed name="tendon"><joint joint="arm" coef="1"/></fixed></tendon>
<actuator>{}</actuator></mujoco>"""
MOTOR = '<motor joint="arm" ctrlrange="-1 1"/>'


class Crowd(envs.Environment):
    """The robot, with a motor."""

    class Options(envs.TaskOptions):
        objectives: dict[str, dict[str, float]] = {"turn": {"turn": 1.0}, "save": {"effort": -1.0}}
        episode_length: int = 50

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(SCENE.format(MOTOR))

    def initial_qpos(self):
        return self.physics.model.qpos0

    def observe(self) -> Tensor:
        return torch.cat([self.physics.qpos, self.physics.qvel], -1)

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_(action.clamp(-1, 1))

    def terms(self) -> dict[str, Tensor]:
        return {"turn": self.physics.qvel[:, -1], "effort": self.physics.ctrl.square().sum(-1)}

    def failed(self) -> Tensor:
        return torch.zeros(self.num_worlds, dtype=torch.bool, device=self.device)


class Bowling(Crowd):
    """The same scene, where the ball is what pushes move."""

    base_body = "ball"
