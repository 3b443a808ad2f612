"""The Gymnasium adapters follow Gymnasium's API."""

import os
import pickle
import re
import warnings
from unittest.mock import MagicMock

import closed_form
import gymnasium
import numpy as np
import pytest
import torch
from acting import falling
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.passive_env_checker import env_render_passive_checker
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from programs import python

from morlax_torch import MorlaxError, envs
from morlax_torch.adapters.episode_statistics import EpisodeStatistics
from morlax_torch.adapters.gymnasium import GymnasiumEnv, GymnasiumVectorEnv
from morlax_torch.envs.robots.cheetah import Cheetah

TASKS = ("Ant", "Cheetah", "Cheetah3", "Hopper", "Humanoid", "Walker")
HOPPER, WALKER = "morlax_torch/Hopper-v0", "morlax_torch/Walker-v0"


def vector(task: str = HOPPER, num_envs: int = 3, **options) -> GymnasiumVectorEnv:
    made = gymnasium.make_vec(task, num_envs=num_envs, device="cpu", **options)
    assert isinstance(made, GymnasiumVectorEnv)
    return made


@pytest.mark.slow
def test_ids_are_registered_before_any_adapter_is_imported():
    no_display = {name: value for name, value in os.environ.items() if "DISPLAY" not in name}
    program = (
        "import gymnasium, sys, morlax_torch\n"
        "assert not [name for name in sys.modules if name.startswith('morlax_torch.adapters')]\n"
        "env = gymnasium.make('morlax_torch:morlax_torch/Hopper-v0')\n"
        "assert 'mujoco.viewer' not in sys.modules\n"
        "print(env.reset()[0].shape)"
    )
    done = python("-W", "error", "-c", program, env=no_display)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "(13,)"


def test_a_custom_task_gets_an_id_of_its_own():
    class Sprinter(Cheetah):
        class Options(Cheetah.Options):
            objectives: dict[str, dict[str, float]] = {"fast": {"run": 2.0}, "up": {"height": 1.0}}

    envs.register("my_sprinter", Sprinter)
    envs.register("my_sprinter", Sprinter)
    assert vector("morlax_torch/MySprinter-v0").objectives == ("fast", "up")
    with pytest.raises(MorlaxError, match="'hopper' is morlax_torch/Hopper-v0 in Gymnasium"):
        envs.register("Hopper", Sprinter)
    with pytest.raises(MorlaxError, match="unknown environment 'Hopper'"):
        envs.get("Hopper")


@pytest.mark.parametrize("task", TASKS)
def test_a_scalar_environment_passes_gymnasium_s_checker(task):
    objectives = 3 if task == "Cheetah3" else 2
    env = gymnasium.make(f"morlax_torch/{task}-v0", tradeoff=(0.5,) * objectives)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=True)
    # observations are unbounded
    assert all("infinity" in str(warning.message) for warning in caught)


def test_the_reward_is_a_vector_and_with_a_tradeoff_a_scalar():
    plain, weighted = gymnasium.make(HOPPER), gymnasium.make(HOPPER, tradeoff=(0.7, 0.3))
    assert plain.reset()[0].dtype == np.float32
    weighted.reset()
    action = np.full(4, 0.2)
    observation, reward, terminated, truncated, info = plain.step(action)
    assert observation in plain.observation_space
    assert reward in plain.unwrapped.reward_space and reward.shape == (2,)
    assert (terminated, truncated, info) == (False, False, {})
    _, number, _, _, info = weighted.step(action)
    assert isinstance(number, float)
    assert number == pytest.approx(0.7 * reward[0] + 0.3 * reward[1])
    np.testing.assert_array_equal(info["vector_reward"], reward)


def test_torch_s_defaults_change_nothing(dtypes):
    env, rewards = gymnasium.make(HOPPER), []
    for _ in dtypes:
        env.reset()
        rewards.append(env.step(np.zeros(4))[1])
    np.testing.assert_array_equal(*rewards)


def test_the_spec_gives_the_episode_length_without_a_second_time_limit():
    env, envs_ = gymnasium.make(HOPPER, episode_length=5), vector(episode_length=5)
    assert env is env.unwrapped and gymnasium.spec(HOPPER).max_episode_steps is None
    assert env.spec.max_episode_steps == envs_.spec.max_episode_steps == 5
    again = gymnasium.make(env.spec)
    again.reset()
    assert [again.step(np.zeros(4))[3] for _ in range(5)] == [False] * 4 + [True]
    for spec in (env.spec, envs_.spec):
        assert gymnasium.make_vec(spec, num_envs=3).unwrapped.worlds.episode_length == 5
    assert vector(max_episode_steps=7).worlds.episode_length == 7


def test_an_environment_can_be_pickled():
    env = gymnasium.make(HOPPER, tradeoff=(1.0, 0.0), reset_noise=0.1).unwrapped
    other = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(env.reset(seed=3)[0], other.reset(seed=3)[0])
    assert env.step(np.ones(4))[1] == other.step(np.ones(4))[1]


@pytest.mark.parametrize("make", [vector, gymnasium.make])
def test_the_seed_determines_the_initial_states(make):
    one, other = (make(HOPPER, reset_noise=0.1) for _ in range(2))
    assert not np.array_equal(one.reset()[0], other.reset()[0])
    first = np.asarray(one.reset(seed=5)[0])
    np.testing.assert_array_equal(first, other.reset(seed=5)[0])
    second = np.asarray(one.reset()[0])
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(second, other.reset()[0])
    if make is vector:  # also a seed for each world
        first, _ = one.reset(seed=np.array([3, 4, 5]))
        assert torch.equal(first, other.reset(seed=[3, 4, 5])[0])
        assert not torch.equal(first, other.reset(seed=(3, 4, 6))[0])
        assert (first[0] != first[1]).any()


@pytest.mark.usefixtures("opengl")
def test_frames_are_valid_and_show_each_world_s_motion():
    look = {"render_mode": "rgb_array", "width": 120, "height": 90}
    vectors, single = vector(num_envs=2, **look), gymnasium.make(HOPPER, **look)
    for env in (vectors, single):
        assert env.metadata["render_fps"] == 100
        with pytest.raises(MorlaxError, match="call reset first"):
            env.render()
        env.reset()
    before = env_render_passive_checker(single.unwrapped)
    for _ in range(20):
        vectors.step(torch.tensor([[0.0] * 4, [1.0] * 4]))
        single.step(np.ones(4))
    still, moving = vectors.render()
    after = single.render()
    assert before.shape == after.shape == still.shape == (90, 120, 3)
    assert (before != after).any() and (still != moving).any()
    np.testing.assert_array_equal(moving, after)
    for env in (vectors, single, single):
        env.close()


def test_the_viewer_window_follows_the_simulation(monkeypatch):
    import glfw
    import mujoco.viewer

    monkeypatch.setattr(glfw, "init", lambda: False)
    with pytest.raises(MorlaxError, match="there is no screen here: use 'rgb_array'"):
        gymnasium.make(HOPPER, render_mode="human").reset()
    heights, launch = [], MagicMock()
    viewer = launch.return_value
    viewer.sync.side_effect = lambda: heights.append(launch.call_args.args[1].qpos[1])
    monkeypatch.setattr(glfw, "init", lambda: True)
    monkeypatch.setattr(mujoco.viewer, "launch_passive", launch)
    env = gymnasium.make(HOPPER, render_mode="human")
    env.reset()
    for _ in range(3):
        env.step(np.zeros(4))
    assert len(heights) == 4 and heights[0] > heights[-1]
    env.close()
    viewer.close.assert_called_once_with()


def test_vector_environments_return_detached_tensors_and_vector_rewards():
    env = vector("morlax_torch/Cheetah3-v0", num_envs=5)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert env.num_envs == 5 and env.reward_space.shape == (3,)
    assert env.single_observation_space.shape == (17,) and env.observation_space.shape == (5, 17)
    assert env.single_action_space.shape == (6,) and env.action_space.shape == (5, 6)
    observation, info = env.reset(seed=0)
    assert observation.numpy() in env.observation_space and info == {}
    actions = torch.full((5, 6), 0.3, requires_grad=True)
    first = env.step(actions.tanh())[:4]
    before = [values.clone() for values in first]
    observation, reward, terminated, truncated, info = env.step(-actions)
    for values, copy in zip(first, before, strict=True):
        assert torch.equal(values, copy) and not values.requires_grad
    assert observation.numpy() in env.observation_space
    assert reward.shape == (5, 3) and reward.dtype == torch.float32
    assert terminated.dtype == truncated.dtype == torch.bool
    assert terminated.shape == truncated.shape == (5,)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int64])
def test_on_the_cpu_actions_can_be_arrays(dtype):
    actions = np.array([[1, 0, 0, -1], [0, 1, -1, 0], [0, 0, 0, 0]], dtype=dtype)
    actions.flags.writeable = False
    one, other = vector(), vector()
    one.reset(), other.reset()
    for array in (actions, actions[::-1], actions.astype(actions.dtype.newbyteorder())):
        found, expected = one.step(array), other.step(torch.tensor(array.astype(dtype, order="C")))
        assert all(map(torch.equal, found[:4], expected[:4]))
    single = gymnasium.make(WALKER)
    single.reset(seed=0)
    single.step(np.ones(single.action_space.shape, np.float32)[::-1])


def test_one_world_takes_actions_of_a_network_in_half_precision():
    rewards = []
    for dtype in (torch.float32, torch.float16, torch.bfloat16):
        env = gymnasium.make(HOPPER)
        env.reset(seed=0)
        rewards.append(env.step(torch.full((4,), 0.5, dtype=dtype, requires_grad=True))[1])
    np.testing.assert_array_equal(rewards[1:], rewards[:1] * 2)


def test_vector_environments_match_gymnasium_s_sync_vector_env():
    options = {"tradeoff": (0.7, 0.3), "episode_length": 100}
    found = vector(WALKER, **options)
    singles = [lambda: gymnasium.make(WALKER, **options)] * 3
    reference = SyncVectorEnv(singles, autoreset_mode=AutoresetMode.SAME_STEP)
    np.testing.assert_array_equal(found.reset(seed=0)[0], reference.reset(seed=0)[0])
    ended = 0
    for _ in range(110):
        action = falling(3)
        observation, reward, *flags, info = found.step(action)
        expected, numbers, *expected_flags, expected_info = reference.step(action.numpy())
        np.testing.assert_array_equal(observation, expected)
        np.testing.assert_array_equal(flags, expected_flags)
        np.testing.assert_allclose(reward, numbers, rtol=1e-5)
        done = np.logical_or(*expected_flags)
        np.testing.assert_array_equal(info["_final_obs"], done)
        np.testing.assert_array_equal(info["_final_info"], done)
        for world in done.nonzero()[0]:
            last = expected_info["final_obs"][world]
            np.testing.assert_array_equal(info["final_obs"][world], last)
            paid = expected_info["final_info"]["vector_reward"][world]
            np.testing.assert_array_equal(info["final_info"]["vector_reward"][world], paid)
        for world in (~done).nonzero()[0]:
            paid = expected_info["vector_reward"][world]
            np.testing.assert_array_equal(info["vector_reward"][world], paid)
        assert info["_vector_reward"].all()
        ended += done.sum()
    assert ended == 1 + 2 + 1  # one truncation, and three falls


def test_episodes_after_a_reset_are_whole_whatever_a_task_s_default():
    class Staggered(Cheetah):
        class Options(Cheetah.Options):
            stagger: bool = True  # as in mjlab's tasks

    envs.register("staggered", Staggered)
    for options, whole in (({}, True), ({"stagger": True}, False)):
        env = vector("morlax_torch/Staggered-v0", 9, episode_length=6, **options)
        env.reset(seed=0)
        ends = [env.step(torch.zeros(9, 6))[3].all().item() for _ in range(6)]
        assert (ends == [False] * 5 + [True]) == whole


def test_statistics_sum_each_objective_over_whole_episodes():
    env = EpisodeStatistics(vector(WALKER, num_envs=4, episode_length=100), gamma=0.9)
    env.reset(seed=0)
    rewards: list[list[np.ndarray]] = [[] for _ in range(4)]
    lengths = []
    for _ in range(210):
        _, reward, terminated, truncated, info = env.step(falling())
        np.testing.assert_array_equal(info["_episode"], terminated | truncated)
        for world in range(4):
            rewards[world].append(reward[world].double().numpy())
            seen = {name: values[world].numpy() for name, values in info["episode"].items()}
            if not info["_episode"][world]:
                assert not any(values.any() for values in seen.values())
                continue
            lengths.append(len(rewards[world]))
            assert seen["l"] == lengths[-1] and 0 < seen["t"] < 60
            np.testing.assert_allclose(seen["r"], np.sum(rewards[world], 0), rtol=1e-5)
            discounts = 0.9 ** np.arange(lengths[-1])
            np.testing.assert_allclose(seen["dr"], discounts @ rewards[world], rtol=1e-5)
            rewards[world] = []
    assert len(lengths) > 8 and len(set(lengths)) == 4


def step(make, action):
    env = make(HOPPER)
    env.reset()
    return env.step(action)


MISTAKES = {
    "did you mean 'rgb_array'": lambda: GymnasiumEnv("hopper", render_mode="rgb_aray"),
    "use gymnasium.make_vec": lambda: GymnasiumEnv(f"{closed_form.__file__}:Quadratic"),
    "unknown backend 'bullet'": lambda: vector(backend="bullet"),
    "one trade-off is needed": lambda: vector(tradeoff=[(1.0, 0.0)] * 3),
    "not negative": lambda: gymnasium.make(HOPPER, tradeoff=(-1, 2)),
    "step was called before": lambda: gymnasium.make(HOPPER).step(np.zeros(4)),
    "call reset first": lambda: vector().step(torch.zeros(3, 4)),
    "reset takes no options": lambda: gymnasium.make(HOPPER).reset(options={"x": 1}),
    "of 4 finite numbers, not array([[0.,": lambda: step(gymnasium.make, np.zeros((1, 4))),
    "of 4 finite numbers, not [0, 0, nan, 0]": lambda: step(gymnasium.make, [0, 0, np.nan, 0]),
    "finite numbers, not tensor(": lambda: step(gymnasium.make, torch.zeros(4, device="meta")),
    "actions of shape (3, 4)": lambda: step(vector, torch.zeros(3, 5)),
    "not (3, 4) of torch.float32 on meta": lambda: step(vector, torch.zeros(3, 4, device="meta")),
    "not list: use torch.as_tensor": lambda: step(vector, [[0.0] * 4] * 3),
    "of numbers on cpu, not ndarray": lambda: step(vector, np.full((3, 4), "left")),
    "each of the 3 worlds, not [1, 2]": lambda: vector().reset(seed=[1, 2]),
    "integer from 0, or one for each": lambda: vector().reset(seed=[1, 2, None]),
    "Known: rgb_array": lambda: vector(render_mode="human"),
    "not drawn together: leave out render_mode": lambda: GymnasiumVectorEnv(
        "gymnasium:mo-hopper-v5", 2, "cpu", render_mode="rgb_array"
    ),
    ", not EpisodeStatistics": lambda: EpisodeStatistics(EpisodeStatistics(vector())),
}


@pytest.mark.parametrize("sentence", MISTAKES)
def test_a_mistake_raises_a_clear_error(sentence):
    with pytest.raises(MorlaxError, match=re.escape(sentence)):
        MISTAKES[sentence]()


@pytest.mark.parametrize("make", [gymnasium.make, vector])
def test_an_unknown_option_is_also_a_type_error_in_python_s_words(make):
    with pytest.raises(TypeError, match="got an unexpected keyword argument 'frameskip'") as error:
        make(HOPPER, frameskip=2)
    assert isinstance(error.value, MorlaxError)
    assert "unknown option 'frameskip'. Known: design, episode_length" in str(error.value)
