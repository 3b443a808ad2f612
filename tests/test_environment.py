"""Episodes end, restart and repeat the way a learner requires."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from acting import random_actions, still
from same import assert_same
from torch import Tensor

from morlax_torch import MorlaxError, envs

BACKENDS = ("mujoco", "warp")
BUILT_IN = [name for name in envs.names() if "/" not in name]
SINGLE = 1e-5  # largest difference between single precision and C MuJoCo's forward pass


@pytest.fixture(params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> str:
    return request.param


def make(task: str, backend: str, worlds: int = 3, **options) -> envs.Environment:
    return envs.make(task, worlds, "cpu", backend=backend, **options)


def state(env: envs.Environment) -> dict[str, Tensor]:
    """Return the state of each world, without the random generator."""
    names = ("qpos", "qvel", "warmstart", "sensors")
    return {name: getattr(env.physics, name).clone() for name in names} | {"age": env.age.clone()}


def forward(model: mujoco.MjModel, qpos: Tensor, qvel: Tensor) -> mujoco.MjData:
    """Return a state as evaluated by C MuJoCo."""
    data = mujoco.MjData(model)
    data.qpos, data.qvel = qpos.double().numpy(), qvel.double().numpy()
    mujoco.mj_forward(model, data)
    return data


# Ends of episodes


def test_actions_of_another_shape_or_type_are_one_sentence():
    env = envs.make("hopper", 2, "cpu")
    before, A = env.reset(), env.action_size
    wrong = [torch.zeros(shape) for shape in ((A,), (1, A), (2, A + 1), (2, 1, A))]
    wrong += [torch.zeros(2, A, dtype=torch.int64), torch.zeros(2, A, device="meta")]
    for action in wrong:
        with pytest.raises(MorlaxError, match=rf"step needs actions of shape \(2, {A}\) .* not "):
            env.step(action)
    with pytest.raises(MorlaxError, match=r"as a torch\.Tensor, not ndarray"):
        env.step(np.zeros((2, A)))
    assert torch.equal(env.critic_observation(), before)
    env.step(torch.zeros(2, A, dtype=torch.float64))


@pytest.mark.parametrize("task", ["walker", "ant"])
def test_the_default_dtype_changes_no_step(task, backend, dtypes):
    steps = []
    for _ in dtypes:
        random = {"friction": (0.5, 1.5), "push": 0.5, "push_every": 2, "action_delay": (0, 2)}
        env = make(task, backend, reset_noise=0.01, randomization=random)
        action = torch.full((3, env.action_size), 0.3)
        steps.append([list(env.step(action)[:5]) for _ in range(5)])
    assert_same(*steps)
    assert steps[1][-1][1].dtype == torch.float32


def test_an_episode_is_truncated_at_its_full_length(backend):
    env = make("cheetah", backend, episode_length=4)
    for age in (1, 2, 3):
        step = env.step(still(env))
        assert not (step.truncated | step.terminated).any()
        assert env.age.tolist() == [age] * 3
    step = env.step(still(env))
    assert step.truncated.all()
    assert not step.terminated.any()
    assert env.age.tolist() == [0, 0, 0]
    assert not env.step(still(env)).truncated.any()


def test_a_failure_ends_only_its_own_world_s_episode_and_still_pays_rewards(backend):
    env = make("cheetah", backend)
    env.step(still(env))
    env.physics.qpos[1, 2] = 2.0  # radians: tipping onto its back
    step = env.step(still(env))
    assert step.terminated.tolist() == [False, True, False]
    assert not step.truncated.any()
    assert env.age.tolist() == [2, 0, 2]
    assert step.reward[1, 1] == 5.0  # alive, with zero actions
    assert env.blowups == 0


def test_failing_on_the_last_step_terminates_instead_of_truncating(backend):
    env = make("cheetah", backend, episode_length=2)
    env.step(still(env))
    env.physics.qpos[1, 2] = 2.0
    step = env.step(still(env))
    assert step.terminated.tolist() == [False, True, False]
    assert step.truncated.tolist() == [True, False, True]
    assert env.age.tolist() == [0, 0, 0]


def test_without_auto_reset_an_episode_continues_after_its_end(backend):
    env = make("hopper", backend, episode_length=2, auto_reset=False)
    ends = []
    for _ in range(3):
        step = env.step(still(env))
        ends.append(step.truncated.all().item())
        assert torch.equal(step.observation, env.observe().float())
    assert ends == [False, True, True]
    assert env.age.tolist() == [3, 3, 3]


# Restarts


def test_auto_reset_restores_only_finished_worlds(backend):
    env, twin = make("humanoid", backend), make("humanoid", backend, auto_reset=False)
    start = state(make("humanoid", backend))
    for action in random_actions(env, 9):
        env.step(action)
        twin.step(action)
    for either in (env, twin):
        either.physics.qpos[1, 2] = 0.3  # meters: on the floor
        step = either.step(still(either))
        assert step.terminated.tolist() == [False, True, False]

    restarted, continued = state(env), state(twin)
    for name, value in restarted.items():
        assert torch.equal(value[1], start[name][1]), name
        assert torch.equal(value[[0, 2]], continued[name][[0, 2]]), name
        if name != "age":
            assert not torch.equal(continued[name][1], start[name][1]), name


@pytest.mark.parametrize("task", BUILT_IN)
def test_no_state_carries_over_between_episodes(task, backend):
    length = 40  # long enough for some random robots to fail, not all
    env = make(task, backend, episode_length=length)
    script = random_actions(env, length)
    worlds = torch.arange(env.num_worlds)

    episodes: list[list[list[Tensor]]] = [[[]] for _ in worlds]
    for _ in range(2 * length):
        step = env.step(script[env.age.long(), worlds])  # every episode repeats the same actions
        ends = step.terminated | step.truncated
        seen = torch.cat([step.observation, step.reward, step.final_observation], -1)
        for world in worlds:
            episodes[world][-1].append(seen[world])
            if ends[world]:
                episodes[world].append([])

    for first, *later in episodes:  # the first episode has no predecessor
        assert len(later) >= 2
        for episode in later:
            assert all(map(torch.equal, episode, first))
        assert all(len(episode) == len(first) for episode in later[:-1])


def test_reset_restarts_every_world_and_restart_the_selected_ones(backend):
    env = make("hopper", backend, 16)
    assert (env.age == 0).all()
    assert (env.physics.qpos == env.physics.qpos[0]).all()
    first, start = env.reset(), state(env)
    for action in random_actions(env, 5):
        seen = env.step(action).observation
    before = state(env)
    which = torch.arange(env.num_worlds) % 2 == 1
    assert torch.equal(env.restart(which), torch.where(which[:, None], first, seen))
    for name, value in state(env).items():
        assert torch.equal(value[which], start[name][which]), name
        assert torch.equal(value[~which], before[name][~which]), name
    assert torch.equal(env.reset(), first)
    assert_same(state(env), start)


# Options


def test_staggered_worlds_start_at_different_ages(backend):
    options = {"episode_length": 100, "stagger": True}
    env = make("hopper", backend, 256, **options)
    ages = env.age.clone()
    assert ages.min() < 10
    assert ages.max() >= 90
    assert ages.max() < 100
    assert len(ages.unique()) > 50
    assert torch.equal(make("hopper", backend, 256, **options).age, ages)
    assert not torch.equal(make("hopper", backend, 256, seed=1, **options).age, ages)

    step = env.step(still(env))
    assert torch.equal(step.truncated, ages == 99)
    assert (env.age[step.truncated] == 0).all()  # later episodes have full length


def test_reset_noise_has_the_configured_size(backend):
    noise = 0.05
    env = make("humanoid", backend, 64, reset_noise=noise)
    qpos, qvel = env.physics.qpos, env.physics.qvel
    assert len(qpos.unique(dim=0)) > 55
    exact = make("humanoid", backend, 1).physics.qpos
    shift = (qpos - exact)[:, [0, 1, 2, *range(7, qpos.shape[1])]]
    assert shift.abs().max() <= noise * 1.001
    assert shift.std().item() == pytest.approx(noise / 3**0.5, rel=0.1)
    assert qvel.std().item() == pytest.approx(noise, rel=0.1)
    torch.testing.assert_close(qpos[:, 3:7].norm(dim=-1), torch.ones(64).to(qpos))


def test_sensors_match_the_noisy_initial_state(backend):
    env = make("humanoid", backend, 8, reset_noise=0.05, episode_length=2)
    for action in (None, *random_actions(env, 2)):
        observation = env.reset() if action is None else env.step(action).observation
        if env.age.any():
            continue
        for world in range(env.num_worlds):
            data = forward(env.physics.model, env.physics.qpos[world], env.physics.qvel[world])
            sensors = env.physics.sensors[world]
            np.testing.assert_allclose(sensors, data.sensordata, rtol=0, atol=SINGLE)
            head = data.body("head").xpos[2]
            assert observation[world, 21].item() == pytest.approx(head, abs=SINGLE)


def test_reset_noise_differs_by_episode_and_depends_on_the_seed(backend):
    options = {"reset_noise": 0.05, "episode_length": 3}

    def starts(seed: int) -> list[Tensor]:
        env = make("cheetah", backend, seed=seed, **options)
        steps = [env.step(action) for action in random_actions(env, 6)]
        return [step.observation for step in steps if step.truncated.all()]

    first, second = starts(seed=0)
    assert not torch.equal(first, second)
    assert all(map(torch.equal, starts(seed=0), (first, second)))
    assert not any(map(torch.equal, starts(seed=1), (first, second)))


@pytest.mark.parametrize("iterations", (None, 8))
def test_eight_solver_iterations_converge_and_the_paper_s_two_do_not(backend, iterations):
    with np.load(Path(__file__).parent / "reference" / "walker.npz") as file:
        actions = torch.from_numpy(file["action"]).float()
        converged = file["qpos_converged"][:, -1]
    env = make("walker", backend, 2, solver_iterations=iterations, auto_reset=False)
    for action in actions.unbind(1):
        env.step(action)
    error = np.abs(env.physics.qpos.numpy() - converged).max()
    assert error > 0.1 if iterations is None else error < 1e-3


def test_the_extremities_option_adds_hands_and_feet_to_the_observation(backend):
    blind, seeing = make("humanoid", backend), make("humanoid", backend, extremities=True)
    assert (blind.observation_size, seeing.observation_size) == (58, 67)
    without, with_them = blind.reset(), seeing.reset()
    assert (without[:, 22:25] == 0).all()
    assert torch.equal(with_them[:, :22], without[:, :22])
    assert torch.equal(with_them[:, 34:], without[:, 25:])

    data = forward(seeing.physics.model, seeing.physics.qpos[0], seeing.physics.qvel[0])
    torso = data.body("torso")
    expected = [
        torso.xmat.reshape(3, 3).T @ (data.body(name).xpos - torso.xpos)
        for name in ("right_hand", "left_hand", "right_foot", "left_foot")
    ]
    np.testing.assert_allclose(with_them[0, 22:34], np.concatenate(expected), atol=SINGLE)

    for action in random_actions(blind, 20):
        seen = blind.step(action).observation
        assert (seen[:, 22:25] == 0).all()
        assert torch.equal(seeing.step(action).observation[:, 34:], seen[:, 25:])


# Saved states


@pytest.mark.parametrize("task", ("humanoid", "walker"))
def test_worlds_resume_exactly_from_a_saved_state(task, backend):
    options = {"episode_length": 25, "stagger": True, "reset_noise": 0.02}
    env = make(task, backend, **options)
    actions = random_actions(env, 60)
    for action in actions[:20]:
        env.step(action)
    env.physics.qpos[1] = float("nan")
    env.step(still(env))
    saved, expected, shown = env.state_dict(), state(env), env.observe()
    went_on = [env.step(action) for action in actions[20:]]
    assert sum((step.truncated | step.terminated).sum() for step in went_on) >= 3

    other = make(task, backend, **options)
    other.step(actions[0])  # so that the random generator also has to be restored
    for resumed in (other, env):
        resumed.load_state_dict(saved)  # a copy, which did not change
        assert resumed.blowups == 1
        assert torch.equal(resumed.observe(), shown)
        assert_same(state(resumed), expected)
        for action, then in zip(actions[20:], went_on, strict=True):
            assert_same(resumed.step(action)._asdict(), then._asdict())
