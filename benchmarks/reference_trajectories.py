"""Make the reference files of five robots from their published models.

python benchmarks/reference_trajectories.py MODELS          # compare with tests/reference
python benchmarks/reference_trajectories.py MODELS --write  # replace what differs
python benchmarks/reference_trajectories.py MODELS --mjx    # MJX's array, by mujoco-mjx 3.4.0

MODELS is the folder `src/moplayground/envs/dmcontrol/model` of commit 3052383 of
https://github.com/dynamicmobility/moplayground. Nothing of this repository is imported. The
actions are kept from the files.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

FOLDER = Path(__file__).parents[1] / "tests" / "reference"
CONTROL_STEP = 0.01  # s
CONVERGED = {"iterations": 100, "ls_iterations": 50, "tolerance": 1e-10}


@dataclass
class Task:
    """A published task: timing, first state, observation, failure and reward terms."""

    substeps: int
    scale: float  # of actions
    clipped: bool  # whether scaled actions are clipped to [-1, 1]
    start: list[float]  # qpos
    observe: Callable[[mujoco.MjData], list]
    failed: Callable[[mujoco.MjData], bool]
    terms: Callable[[mujoco.MjData, np.ndarray, np.ndarray], dict[str, float]]
    weights: dict[str, float]
    objectives: dict[str, list[list[str]]]  # terms of each objective, per array
    shared: list[str]  # terms of every objective

    def control(self, action: np.ndarray) -> np.ndarray:
        scaled = self.scale * action
        return scaled.clip(-1, 1) if self.clipped else scaled

    def rewards(self, terms: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        def total(names: list[str]) -> np.ndarray:
            return sum(self.weights[name] * np.asarray(terms[name]) for name in names)

        return {
            array: np.stack([total(names) + total(self.shared) for names in objectives], -1)
            for array, objectives in self.objectives.items()
        }


def planar(data: mujoco.MjData) -> list:
    return [data.qpos[1:], data.qvel.clip(-10, 10)]


def flipped(data: mujoco.MjData) -> bool:
    return not np.isfinite(data.qpos).all() or data.body("torso").xmat[8] < 0.45


def upright(data: mujoco.MjData) -> list:
    torso, head = data.body("torso"), data.body("head").xpos[2:]
    return [data.qpos[7:], head, np.zeros(3), torso.xmat[6:], torso.subtree_linvel, data.qvel]


# The last parameters of `terms`: controls u, and meters moved in the control step, (2,).
TASKS = {
    "cheetah": Task(
        substeps=1,
        scale=1.0,
        clipped=True,
        start=[0.0] * 9,
        observe=planar,
        failed=lambda data: not abs(data.qpos[2]) < np.deg2rad(50),
        terms=lambda data, u, moved: {
            "alive": 1.0,
            "run": min(4.0, moved[0] / CONTROL_STEP),
            "energy": 4 - u @ u,
            "height": data.qpos[1] + 0.2,
        },
        weights={"alive": 1.0, "run": 1.0, "energy": 1.0, "height": 10.0},
        objectives={
            "reward_cheetah2": [["run"], ["energy"]],
            "reward_cheetah3": [["run"], ["energy"], ["height"]],
        },
        shared=["alive"],
    ),
    "walker": Task(
        substeps=2,
        scale=3.0,
        clipped=True,
        start=[0, 1.5, 0, *[0.0] * 6],
        observe=planar,
        failed=lambda data: not (0.8 < data.qpos[1] < 2.0 and -1.0 < data.qpos[2] < 1.0),
        terms=lambda data, u, moved: {
            "alive": 1.0,
            "run": moved[0] / CONTROL_STEP,
            "energy": 4 - u @ u,
        },
        weights={"alive": 1.0, "run": 1.0, "energy": 1.0},
        objectives={"reward": [["run"], ["energy"]]},
        shared=["alive"],
    ),
    "hopper": Task(
        substeps=2,
        scale=3.0,
        clipped=False,
        start=[0, 1.0, 0, *[0.0] * 4],
        observe=planar,
        failed=lambda data: data.qpos[1] < 0.2 or abs(data.qpos[2]) > np.deg2rad(270),
        terms=lambda data, u, moved: {
            "alive": 1.0,
            "run": moved[0] / CONTROL_STEP,
            "jump": max(data.qpos[1] - 0.8, 0),
            "ctrl_cost": u @ u,
            "upright": np.clip(data.qpos[1] - 0.4, -0.2, 0),
        },
        weights={"alive": 1.0, "run": 1.5, "jump": 12.0, "ctrl_cost": -0.0002, "upright": 4.0},
        objectives={"reward": [["run"], ["jump"]]},
        shared=["alive", "ctrl_cost"],
    ),
    "ant": Task(
        substeps=1,
        scale=1.0,
        clipped=True,
        start=[0, 0, 1.0, 1, 0, 0, 0, 0, 0.5, 0, -0.5, 0, -0.5, 0, 0.5],
        observe=lambda data: [data.qpos[2:], data.qvel],
        failed=flipped,
        terms=lambda data, u, moved: {
            "alive": 1.0,
            "vx": moved[0] / CONTROL_STEP,
            "vy": moved[1] / CONTROL_STEP,
            "energy": 8 - u @ u,
        },
        weights={"alive": 1.0, "vx": 1.0, "vy": 1.0, "energy": 0.5},
        objectives={"reward": [["vx"], ["vy"]]},
        shared=["alive", "energy"],
    ),
    "humanoid": Task(
        substeps=2,
        scale=3.0,
        clipped=False,
        start=[0, 0, 1.4, 1, 0, 0, 0, *[0.0] * 21],
        observe=upright,
        failed=lambda data: data.qpos[2] < 0.6,
        terms=lambda data, u, moved: {
            "alive": 1.0,
            "run": moved[0] / CONTROL_STEP,
            "energy": max(3 - np.square(u / 3).sum(), 0),
        },
        weights={"alive": 1.0, "run": 1.0, "energy": 1.0},
        objectives={"reward": [["run"], ["energy"]]},
        shared=["alive"],
    ),
}


def position(name: str, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return x and y of what runs: the humanoid's center of mass, of others the root's joints."""
    if name != "humanoid":
        return data.qpos[:2].copy()
    mass = model.body_mass
    return np.array([mass @ data.xipos[:, axis] / mass.sum() for axis in (0, 1)])


def load(name: str, models: Path) -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_path(str(models / f"{name}.xml"))
    model.opt.timestep = CONTROL_STEP / TASKS[name].substeps
    if name == "ant":  # margins are added since MuJoCo 3.5, before it took the larger one
        model.geom_margin[model.geom("ground").id] = 0.0
    return model


def facts(model: mujoco.MjModel, published: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return a compiled model's properties under the names of the published ones."""

    def names(element: Callable, count: int) -> list[str]:
        return [element(i).name for i in range(count)]

    gravity = dict(zip(("gx", "gy", "gz"), model.opt.gravity, strict=True))
    named = {
        "total_mass": model.body_mass.sum(),
        "sizes": [getattr(model, size) for size in published["sizes_names"]],
        "opt": [
            gravity[option] if option in gravity else getattr(model.opt, option)
            for option in published["opt_names"]
        ],
        "actuator_joint": [model.joint(i).name for i in model.actuator_trnid[:, 0]],
        "body_names": names(model.body, model.nbody),
        "joint_names": names(model.joint, model.njnt),
        "geom_names": names(model.geom, model.ngeom),
        "sizes_names": published["sizes_names"],
        "opt_names": published["opt_names"],
    }
    return {
        fact: np.array(named[fact] if fact in named else getattr(model, fact)) for fact in published
    }


def reset(name: str, model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = TASKS[name].start
    mujoco.mj_forward(model, data)
    return data


def simulated(name: str, model: mujoco.MjModel, actions: np.ndarray) -> dict[str, np.ndarray]:
    """Return all arrays of one seed."""
    task, data = TASKS[name], reset(name, model)
    frames = {key: [getattr(data, key).copy()] for key in ("qpos", "qvel")}
    frames |= {"obs": [np.concatenate(task.observe(data))], "terminated": []}
    for action in actions:
        before = position(name, model, data)
        data.ctrl[:] = control = task.control(action)
        mujoco.mj_step(model, data, task.substeps)
        terms = task.terms(data, control, position(name, model, data) - before)
        values = {f"term_{key}": value for key, value in terms.items()}
        values |= {"qpos": data.qpos.copy(), "qvel": data.qvel.copy()}
        values |= {"obs": np.concatenate(task.observe(data)), "terminated": task.failed(data)}
        for key, value in values.items():
            frames.setdefault(key, []).append(value)
    arrays = {key: np.array(values) for key, values in frames.items()}
    return arrays | task.rewards({key: arrays[f"term_{key}"] for key in task.weights})


def by_mjx(name: str, model: mujoco.MjModel, actions: np.ndarray) -> np.ndarray:
    """Return qpos after each control step of one seed in MJX."""
    import jax
    from mujoco import mjx

    task = TASKS[name]
    compiled, state = mjx.put_model(model), mjx.put_data(model, reset(name, model))
    step = jax.jit(lambda state: mjx.step(compiled, state))
    frames = []
    for action in actions:
        state = state.replace(ctrl=jax.numpy.asarray(task.control(action), "float32"))
        for _ in range(task.substeps):
            state = step(state)
        frames.append(np.array(state.qpos))
    return np.array(frames)


def generated(name: str, models: Path, stored: dict[str, np.ndarray], mjx: bool) -> dict:
    """Return the arrays of one robot's file."""
    task, model, exact = TASKS[name], load(name, models), load(name, models)
    for option, value in CONVERGED.items():
        setattr(exact.opt, option, value)
    actions = stored["action"]  # (S, T, nu)
    if mjx:
        return {"qpos_mjx_converged": np.stack([by_mjx(name, exact, x[:100]) for x in actions])}
    seeds = [simulated(name, model, x) for x in actions]
    resting = reset(name, model)
    if name == "hopper":
        resting.qpos[1] = 0.0  # the published reset counts no height
    resets = task.rewards(task.terms(resting, np.zeros(model.nu), np.full(2, 0.01)))
    published = {key[6:]: value for key, value in stored.items() if key.startswith("model_")}
    return {
        **{key: np.stack([seed[key] for seed in seeds]) for key in seeds[0]},
        **{key.replace("reward", "reset_reward"): value for key, value in resets.items()},
        **{f"model_{key}": value for key, value in facts(model, published).items()},
        "action": actions,
        "qpos_converged": np.stack([simulated(name, exact, x[:100])["qpos"] for x in actions]),
        "term_names": np.array(list(task.weights)),
        "term_weights": np.array(list(task.weights.values())),
        "ctrl_dt": np.array(CONTROL_STEP),
        "n_substeps": np.array(task.substeps),
        "action_scale": np.array(task.scale),
        "mujoco_version": np.array(mujoco.__version__),
    }


def difference(new: np.ndarray, old: np.ndarray) -> float:
    """Return the largest absolute difference, infinite if shapes or texts differ."""
    if new.shape != old.shape:
        return np.inf
    if new.dtype.kind == "U":
        return 0.0 if (new == old).all() else np.inf
    return float(np.abs(new.astype(float) - old).max(initial=0.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("models", type=Path)
    parser.add_argument("--mjx", action="store_true", help="only what MJX computes")
    parser.add_argument("--write", action="store_true", help="replace arrays that differ")
    arguments = parser.parse_args()
    for name in TASKS:
        with np.load(FOLDER / f"{name}.npz") as file:
            stored = dict(file)
        new = generated(name, arguments.models, stored, arguments.mjx)
        print(f"{name}: {len(new)} of {len(stored)} arrays are made")
        for key, value in new.items():
            if far := difference(value, stored[key]):
                print(f"    {key} differs by {far:.1e}")
        if arguments.write:
            np.savez_compressed(FOLDER / f"{name}.npz", **stored | new)


if __name__ == "__main__":
    main()
