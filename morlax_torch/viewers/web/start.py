"""A recording of the robot, which the page shows until it has loaded the robot itself."""

import mujoco
import numpy as np

from ...envs import Environment
from ...networks.policy import Policy
from ..arrays import array_bytes, drawn_arrays

SECONDS = 5.0  # an episode that ends earlier is recorded to its end
FRAME = 0.02  # s between frames, or a control step if that is longer


def start(policy: Policy, env: Environment) -> bytes:
    """Record the robot with even weights, from the task's first state."""
    model = env.physics.model
    data = mujoco.MjData(model)
    act = policy.specialize([1 / len(policy.objectives)] * len(policy.objectives))
    every = max(round(FRAME / env.dt), 1)
    observation, over = env.reset(), False
    places, turns = [], []
    for step in range(round(SECONDS / env.dt) + 1):
        data.qpos[:] = env.physics.qpos[0].numpy()
        mujoco.mj_kinematics(model, data)
        if over or not np.isfinite(data.xpos).all():
            break
        if step % every == 0:
            places.append(data.xpos.copy())
            turns.append(data.xquat.copy())
        observation, _, terminated, truncated, *_ = env.step(act(observation))
        over = bool(terminated | truncated)
    poses = {"places": np.array(places), "turns": np.array(turns)}  # (T, nbody, 3 or 4)
    return array_bytes(
        {**drawn_arrays(model), **poses},
        nbody=model.nbody,
        ngeom=model.ngeom,
        dt=every * env.dt,
        followed=env.base,
    )
