"""Robots of a user: one with a mesh, and others that cannot be traced for the web page."""

import struct
from itertools import product
from pathlib import Path

import numpy as np

MJCF = """
<mujoco model="tumbler">
  <compiler meshdir="meshes"/>
  <option timestep="0.005" integrator="implicitfast"/>
  <asset><mesh file="parts/wedge.stl" scale="0.3 0.2 0.1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="trunk" pos="0 0 0.4">
      <freejoint/>
      <geom type="mesh" mesh="wedge" rgba="0.8 0.3 0.2 1"/>
      <body name="arm" pos="0.2 0 0">
        <joint name="swing" axis="0 1 0" range="-90 90"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="swing" gear="4" ctrlrange="-1 1"/></actuator>
  <sensor><subtreelinvel name="velocity" body="trunk"/></sensor>
</mujoco>
"""

TASKS = '''
import numpy as np
import torch

from morlax_torch.envs import Environment, TaskOptions


class Tumbler(Environment):
    model_file = "tumbler.xml"
    substeps = 4

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"go": {"vx": 1.0}, "save": {"energy": 1.0}}

    def initial_qpos(self):
        return np.array([0, 0, 0.4, 1, 0, 0, 0, 0.0])

    def observe(self):
        velocity = self.physics.sensor("velocity")
        return torch.cat([self.physics.qpos[:, 2:], velocity, self.physics.qvel], -1)

    def apply(self, action):
        self.physics.ctrl.copy_(action.clamp(-1, 1))

    def terms(self):
        return {"vx": self.physics.qvel[:, 0], "energy": 1 - self.physics.ctrl.square().sum(-1)}

    def failed(self):
        return self.physics.qpos[:, 2] < -1


class Carried(Tumbler):
    """The task moves a mocap body, from a place that it draws, and lifts the trunk."""

    @classmethod
    def load_spec(cls):
        spec = super().load_spec()
        spec.worldbody.add_body(name="hand", mocap=True)
        return spec

    def begin(self, fresh):
        place = self.physics.part("mocap_pos")[:, 0, 0]
        place.copy_(torch.where(fresh, self.draws.uniform_(torch.empty_like(place), 0, 1), place))

    def apply(self, action):
        super().apply(action)
        self.physics.part("xfrc_applied")[:, 1, 2] = 100 + 10 * action[:, 0]

    def advance(self):
        self.physics.part("mocap_pos")[:, 0, 2] += 0.01

    def terms(self):
        height = self.physics.part("mocap_pos")[:, 0, 2]
        return {**super().terms(), "near": 1 - (height - self.physics.qpos[:, 2]).abs()}


class Counting(Tumbler):
    """Its state is a number of Python, which no graph contains."""

    steps = 0

    def observe(self):
        return super().observe() + self.steps

    def advance(self):
        self.steps += 1


class Deciding(Tumbler):
    """Python decides by a tensor's number."""

    def apply(self, action):
        self.physics.ctrl.copy_(action if action.sum() > 0 else -action)


class Shuffled(Tumbler):
    """It draws random numbers of an unusual kind."""

    def apply(self, action):
        self.physics.ctrl.copy_(torch.bernoulli(action.abs().clamp(max=1)))
'''


def write(folder: Path) -> str:
    """Write the robots into `folder`; returns the path of the Python file."""
    (folder / "meshes" / "parts").mkdir(parents=True)
    (folder / "meshes" / "parts" / "wedge.stl").write_bytes(wedge())
    (folder / "tumbler.xml").write_text(MJCF)
    (folder / "robots.py").write_text(TASKS)
    return str(folder / "robots.py")


def wedge() -> bytes:
    """Return a binary STL of a box with one edge pulled out, which no symmetry hides."""
    corners = np.array(list(product((-0.5, 0.5), repeat=3)), np.float32)
    corners[7] += [0.4, 0.2, 0.3]
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [(a, b, c) for p, q, r, s in sides for a, b, c in ((p, q, r), (p, r, s))]
    data = bytes(80) + struct.pack("<I", len(faces))
    for face in faces:
        data += struct.pack("<3f", 0, 0, 0) + corners[list(face)].tobytes() + bytes(2)
    return data
