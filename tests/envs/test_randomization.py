"""Domain randomization: model variation, observation noise, action delay and pushes."""

import math

import mujoco
import numpy as np
import pytest
import torch
from acting import random_actions, still
from crowd import DOOR, MOTOR, ROBOT, SCENE
from same import assert_same

from morlax_torch import MorlaxError, envs
from morlax_torch.envs.physics.mujoco import Batch, PythonBatch
from morlax_torch.envs.worlds.trees import base_of

MODELS = {
    "friction": (0.3, 1.5),
    "mass": (0.7, 1.3),
    "strength": (0.6, 1.4),
    "fields": {"dof_damping": (0.5, 2.0)},
}
MOMENTS = {
    "observation_noise": {"position": 0.01, "velocity": 0.2},
    "action_delay": (0, 2),
    "push": 0.5,
    "push_every": 4,
}
EXACT, SINGLE = 1e-12, 1e-5


def make(
    task: str, backend: str, randomization: dict, worlds: int = 4, seed: int = 0, **options
) -> envs.Environment:
    options["randomization"] = randomization
    return envs.make(task, worlds, "cpu", backend, seed, **options)


def separate_models(env: envs.Environment) -> list[mujoco.MjModel]:
    """Compile a separate model for each world, with that world's randomized fields."""
    state, models = env.state_dict(), []
    for world in range(env.num_worlds):
        model = type(env).load_model()
        model.opt.iterations = env.physics.model.opt.iterations
        for key, values in state.items():
            if key.startswith("model."):
                getattr(model, key.removeprefix("model."))[:] = values[world].numpy()
        mujoco.mj_setConst(model, mujoco.MjData(model))
        models.append(model)
    return models


def errors(env: envs.Environment, steps: int) -> np.ndarray:
    """Return the largest position errors against separate models, (steps,)."""
    models = separate_models(env)
    worlds = [mujoco.MjData(model) for model in models]
    for world in worlds:
        world.qpos = env.initial_qpos()
    found = []
    for action in random_actions(env, steps):
        env.step(action)
        for i, (model, world) in enumerate(zip(models, worlds, strict=True)):
            world.ctrl = env.physics.ctrl[i].double().numpy()
            mujoco.mj_step(model, world, nstep=env.substeps)
        positions = env.physics.qpos.double().numpy()
        found.append(np.abs(positions - [world.qpos for world in worlds]).max())
    return np.array(found)


@pytest.mark.parametrize("task", ("cheetah", "hopper", "ant", "humanoid", "pgmorl/walker2d"))
def test_randomized_c_mujoco_worlds_match_separately_compiled_models(task):
    env = make(task, "mujoco", MODELS, auto_reset=False)
    assert errors(env, 60).max() < EXACT
    assert (env.physics.qpos[1:] - env.physics.qpos[0]).abs().amax(1).min() > 1e-3


@pytest.mark.parametrize("task", ("cheetah", "hopper", "ant", "humanoid"))
def test_randomized_warp_worlds_start_like_separately_compiled_models(task):
    assert errors(make(task, "warp", MODELS, auto_reset=False), 10).max() < SINGLE


def test_friction_varies_by_world_mass_by_body_and_strength_by_motor():
    env = make("hopper", "mujoco", MODELS, worlds=2000)
    model = env.physics.model

    def factors(name: str) -> np.ndarray:
        """Return the factors (2000, ...) of a field's non-zero entries."""
        nominal = getattr(model, name)
        return env.state_dict()[f"model.{name}"].numpy()[:, nominal != 0] / nominal[nominal != 0]

    floor, bodies, motors = factors("geom_friction"), factors("body_mass"), factors("dof_damping")
    np.testing.assert_allclose(floor, floor[:, :1].repeat(floor.shape[1], 1))
    np.testing.assert_allclose(factors("pair_friction")[:, :1], floor[:, :1])
    np.testing.assert_allclose(factors("body_inertia"), bodies.repeat(3, 1))
    gains = factors("actuator_gainprm")
    assert gains.shape == (2000, model.nu)
    for drawn, (low, high) in (
        (floor[:, 0], (0.3, 1.5)),
        (bodies, (0.7, 1.3)),
        (gains, (0.6, 1.4)),
        (motors, (0.5, 2.0)),
    ):
        assert low <= drawn.min() and drawn.max() <= high
        assert drawn.mean().item() == pytest.approx((low + high) / 2, rel=0.02)
        assert drawn.std().item() == pytest.approx((high - low) / math.sqrt(12), rel=0.05)
        assert np.abs(np.corrcoef(drawn.T) - np.eye(drawn[0].size)).max() < 0.1


@pytest.mark.parametrize("worlds", [1, 3])
def test_one_factor_for_all_worlds_changes_derived_constants_too(worlds, backend):
    env = make("humanoid", backend, {"mass": (1.5, 1.5)}, worlds)
    env.reset()
    env.step(still(env))
    nominal = envs.make("humanoid", 1, "cpu", "mujoco").physics.model
    for world, model in enumerate(separate_models(env)):
        np.testing.assert_allclose(model.body_subtreemass, 1.5 * nominal.body_subtreemass)
        data = mujoco.MjData(model)
        data.qpos[:] = env.physics.qpos[world].numpy()
        mujoco.mj_forward(model, data)
        center = env.physics.sensors[world].numpy()
        np.testing.assert_allclose(center, data.sensordata, atol=0.05)  # of the step before


def test_randomization_is_disabled_by_default(backend):
    off = {"observation_noise": {"position": 0.0}, "action_delay": (0, 0), "push": 0.0}
    plain = envs.make("humanoid", 3, "cpu", backend, auto_reset=False)
    explicit = make("humanoid", backend, off, worlds=3, auto_reset=False)
    for action in random_actions(plain, 20):
        one, other = plain.step(action), explicit.step(action)
        assert torch.equal(one.observation, other.observation)
        assert torch.equal(one.reward, other.reward)
    assert not any(name.startswith("model.") for name in explicit.state_dict())


def test_noise_has_the_configured_std_and_affects_only_observations(backend):
    deviations = {"position": 0.01, "position.knee": 0.3, "velocity.knee": 0.2}
    clean = envs.make("hopper", 512, "cpu", backend)
    noisy = make("hopper", backend, {"observation_noise": deviations}, worlds=512)
    found = []
    for action in random_actions(clean, 40):
        without, with_it = clean.step(action), noisy.step(action)
        assert torch.equal(noisy.physics.qpos, clean.physics.qpos)
        assert torch.equal(with_it.reward, without.reward)
        found.append(with_it.observation - without.observation)
    noise = torch.stack(found)  # (steps, worlds, O)
    names = [part.name for part in clean.layout() for _ in range(part.size)]
    expected = [deviations.get(name, deviations.get(name.split(".")[0], 0)) for name in names]
    samples = noise[..., 0].numel()
    for index, deviation in enumerate(expected):
        values = noise[..., index]
        assert values.mean().abs() <= 5 * deviation / math.sqrt(samples)
        assert values.std().item() == pytest.approx(deviation, rel=0.03)
    along = torch.corrcoef(noise[..., 0].reshape(40, -1))  # correlation between steps
    assert (along - torch.eye(40)).abs().max() < 5 / math.sqrt(512)


def test_each_world_draws_a_new_delay_per_episode_and_clears_its_queue(backend):
    length, worlds = 6, 32
    prompt = envs.make("cheetah", worlds, "cpu", backend, episode_length=length)
    late = make("cheetah", backend, {"action_delay": (1, 3)}, worlds, episode_length=length)
    actions, seen = random_actions(prompt, 30), set()
    for episode in actions.split(length):
        by = late.state_dict()["late"]
        seen.add(tuple(by.tolist()))
        assert set(by.tolist()) == {1, 2, 3}
        for time in range(length):
            rows = [episode[time - d, i] if time >= d else still(late)[i] for i, d in enumerate(by)]
            prompt.step(torch.stack(rows))
            late.step(episode[time])
            assert torch.equal(late.physics.qpos, prompt.physics.qpos)
    assert len(seen) == 5


@pytest.mark.parametrize(
    ("task", "horizontal"), [("ant", [0, 1]), ("humanoid", [0, 1]), ("hopper", [0])]
)
def test_a_push_changes_the_horizontal_velocity_by_the_configured_amount(task, horizontal, backend):
    worlds = 256
    calm = envs.make(task, worlds, "cpu", backend)
    pushed = make(task, backend, {"push": 0.7, "push_every": 1}, worlds)
    calm.step(still(calm))  # the robots are in the air
    pushed.step(still(pushed))
    change = (pushed.physics.qvel - calm.physics.qvel).double()
    size = change[:, horizontal].norm(dim=-1)
    torch.testing.assert_close(size, torch.full_like(size, 0.7), rtol=0, atol=1e-4)
    others = [i for i in range(change.shape[1]) if i not in horizontal]
    assert change[:, others].abs().max() < 1e-4
    assert change[:, horizontal].mean(0).abs().max() < 5 * 0.7 / math.sqrt(worlds)


def test_the_robot_is_the_tree_with_the_most_actuators():
    for actuators, base in {
        '<motor joint="door"/>': DOOR,
        '<motor joint="door"/>' + 2 * MOTOR: ROBOT,
        '<motor joint="door"/>' + MOTOR: ROBOT,  # which has more degrees of freedom
        '<motor tendon="tendon"/>': ROBOT,
        '<general site="hand" gear="0 0 1 0 0 0"/>': ROBOT,
        '<adhesion body="arm" ctrlrange="0 1"/>': ROBOT,
        '<motor jointinparent="arm"/>': ROBOT,
    }.items():
        assert base_of(mujoco.MjModel.from_xml_string(SCENE.format(actuators))) == base
    scene = mujoco.MjModel.from_xml_string(SCENE.format(""))
    assert base_of(scene, "arm") == ROBOT
    with pytest.raises(MorlaxError, match="unknown body 'rbot': did you mean 'robot'"):
        base_of(scene, "rbot")
    assert base_of(mujoco.MjModel.from_xml_string("<mujoco/>")) == 0


def test_pushes_come_at_the_configured_rate_on_every_step():
    env = make("hopper", "mujoco", {"push": 1.0, "push_every": 10}, worlds=2000)
    for _ in range(3):
        before = env.physics.qvel[:, 0].clone()
        env.step(still(env))
        share = ((env.physics.qvel[:, 0] - before).abs() > 0.9).double().mean().item()
        assert share == pytest.approx(0.1, abs=5 * math.sqrt(0.09 / 2000))


@pytest.mark.parametrize("task", ("humanoid", "hopper"))
def test_randomized_worlds_resume_exactly_from_a_saved_state(task, backend):
    options = {"episode_length": 12, "reset_noise": 0.02, "stagger": True}
    everything = {**MODELS, **MOMENTS}
    env = make(task, backend, everything, **options)
    actions = random_actions(env, 40)
    for action in actions[:15]:
        env.step(action)
    env.physics.qpos[1] = float("nan")
    env.step(still(env))
    saved, shown = env.state_dict(), env.critic_observation()
    went_on = [env.step(action) for action in actions[15:]]

    # another seed draws other models and noise; initial states are not part of a saved state
    other = make(task, backend, everything, seed=1, **options)
    other.starts = env.starts
    other.step(actions[0])
    for resumed in (other, env):
        resumed.load_state_dict(saved)  # a copy, which did not change
        assert resumed.blowups == 1
        assert torch.equal(resumed.critic_observation(), shown)
        for action, then in zip(actions[15:], went_on, strict=True):
            assert_same(resumed.step(action)._asdict(), then._asdict())


@pytest.mark.parametrize(
    ("randomization", "expected"),
    [
        ({"friction": (2, 1)}, "a range goes from the smaller to the larger"),
        ({"mass": (0, 1)}, "greater than 0"),
        ({"observation_noise": {"positon": 1.0}}, "did you mean 'position'"),
        ({"fields": {"tendon_range": (1, 2)}}, "cannot vary 'tendon_range' .* that this robot has"),
    ],
)
def test_invalid_randomization_gives_a_clear_error(randomization, expected, backend):
    with pytest.raises(MorlaxError, match=expected):
        make("hopper", backend, randomization)


def test_worlds_without_mujoco_batch_are_simulated_alike(monkeypatch):
    found = []
    for batch in (Batch, PythonBatch):
        monkeypatch.setattr("morlax_torch.envs.physics.mujoco.Batch", batch)
        env = make("hopper", "mujoco", MODELS)
        env.reset()
        for number, action in enumerate(random_actions(env, 50)):
            env.move_only(torch.arange(env.num_worlds) >= number // 20)  # first all, then fewer
            step = env.step(action)
        found.append((step.final_observation, step.reward, env.physics.warmstart.clone()))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=EXACT, atol=EXACT)


def test_a_task_that_varies_its_model_itself_keeps_what_the_options_randomize():
    class Shifted(envs.get("hopper")):
        def vary_model(self, seed: int) -> dict[str, np.ndarray]:
            added = super().vary_model(seed) if self.adds else {}
            shift = np.random.default_rng(seed).uniform(0, 0.05, (self.num_worlds, 1, 1))
            return {**added, "body_ipos": self.physics.model.body_ipos + shift}

    envs.registry._REGISTRY["shifted"] = Shifted
    Shifted.adds = True
    model = make("shifted", "mujoco", {"friction": (0.3, 1.5)}).state_dict()
    assert {"model.geom_friction", "model.body_ipos"} <= model.keys()
    Shifted.adds = False
    with pytest.raises(MorlaxError, match="leaves out geom_friction"):
        make("shifted", "mujoco", {"friction": (0.3, 1.5)})
