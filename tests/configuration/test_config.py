"""The shipped configs load, and invalid configs are refused before a run is created."""

from importlib import resources
from pathlib import Path

import pytest
import torch
import yaml

from morlax_torch import MorlaxError, config_for, envs
from morlax_torch.commands.terminal.arguments import read
from morlax_torch.configuration import files as config_files
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import file_values, task_values, write_record
from morlax_torch.envs.registry import TASKS
from morlax_torch.host.files import task_of


@pytest.mark.parametrize("device", ["cpu", "cuda"])
@pytest.mark.parametrize("env", envs.names())
def test_every_task_has_a_config_for_cpu_and_gpu(env, device):
    config = load_config(task_values(env, device))
    assert config.env == env
    assert config.max_env_steps is not None
    assert load_config(config.model_dump(mode="json")) == config


def test_an_algorithm_changes_single_tasks_and_a_user_changes_those():
    swimmer, walker = (
        config_for(f"pgmorl/{name}", algorithm="hyper-sac") for name in ("swimmer", "walker2d")
    )
    assert (swimmer.method.discount, walker.method.discount) == (0.9975, 0.99)
    assert swimmer.method.updates == walker.method.updates
    shorter = read(
        ["--env", "pgmorl/swimmer", "--algorithm", "hyper-sac", "--method.discount", "0.9"]
    )
    assert shorter[0].method.discount == 0.9


def test_an_algorithm_changes_tasks_that_have_a_config():
    folder = Path(str(resources.files("morlax_torch.configs")))
    for file in (folder / "algorithms").glob("*.yaml"):
        for env in yaml.safe_load(file.read_text()).get("tasks", {}):
            assert (folder / f"{env.replace(':', '/')}.yaml").is_file(), env


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_the_file_of_a_task_has_the_task_s_values_wherever_it_lies(device, tmp_path):
    folder, file = Path(str(resources.files("morlax_torch.configs"))), tmp_path / "mine.yaml"
    for env in (env for env in TASKS if (folder / f"{env}.yaml").is_file()):
        file.write_text((folder / f"{env}.yaml").read_text())
        assert load_config(file_values(file, device)) == load_config(task_values(env, device))


def test_default_objectives_are_those_of_the_paper():
    own = [env for env in TASKS if "/" not in env]
    objectives = {env: tuple(load_config({"env": env}).task.objectives) for env in own}
    assert objectives == {
        "ant": ("vx", "vy"),
        "bruce": ("joints", "base", "swing", "rigid", "smooth", "energy"),
        "cheetah": ("run", "energy"),
        "cheetah3": ("run", "energy", "height"),
        "hopper": ("run", "jump"),
        "humanoid": ("run", "energy"),
        "walker": ("run", "energy"),
    }


def test_evaluations_count_no_guide():
    config = load_config({"env": "hopper", "device": "cpu", "task": {"guide": {"run": 2.0}}})
    rewards = []
    for evaluating in (False, True):
        env = config.make_worlds(2, 0, evaluating)
        step = env.step(torch.zeros(2, env.action_size))
        rewards.append(step.reward)
    guided = 2.0 * step.terms["run"][:, None].expand(2, 2).float()
    torch.testing.assert_close(rewards[0] - rewards[1], guided)


@pytest.mark.parametrize("env", ["ant", "cheetah", "hopper", "humanoid", "walker"])
@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_paper_configs_are_the_same_on_cpu_and_gpu(env, device):
    file = Path(str(resources.files("morlax_torch.configs") / "paper" / f"{env}.yaml"))
    config = load_config(file_values(file, device))
    assert config.env == env
    assert (config.num_clusters, config.decay_fraction, config.ppo.entropy) == (8, 0.0, 0.01)
    # batch size x minibatches = worlds, in all five tasks of the paper
    batch = 32 if env == "hopper" else 64
    assert config.ppo.minibatches * batch == config.worlds


UNUSABLE = {
    "worlds of no clusters": ({"worlds": 100}, r"must divide worlds \(100\): try --worlds 96"),
    "a row per corner": ({"sampling": {"corners": 3}}, "must be 0 or 2"),
    "no focus": (
        {"sampling": {"focus": [0.0, 0.0, 0.5]}, "max_env_steps": 9},
        "at least one above zero",
    ),
    "a focus without an end": (
        {"sampling": {"focus": [1.0, 0.0, 0.5]}, "max_env_steps": None},
        "needs max_env_steps or",
    ),
    "a focus that an algorithm would ignore": (
        {
            "algorithm": "hyper-morl",
            "network": {"type": "single"},
            "sampling": {"corners": 0, "focus": [1.0, 0.0, 0.5]},
            "max_env_steps": 9,
        },
        "sampling.focus is .*, but algorithm hyper-morl needs None: leave it out",
    ),
    "dense": ({"worlds": 60, "sampling": {"mode": "dense"}}, "must divide the 60 worlds"),
    "32 objectives": (
        {"task": {"objectives": {f"run {i}": {"run": 1.0} for i in range(32)}}},
        "32 objectives are too many: use at most 31",
    ),
    "one objective": ({"task": {"objectives": {"all": {"run": 1.0}}}}, "at least two objectives"),
    "no end": ({"decay_fraction": 0.3}, "decay_fraction needs max_env_steps"),
    "an infinite start": ({"task": {"reset_noise": float("inf")}}, "reset_noise: Input should be"),
    "a NaN weight": (
        {"task": {"objectives": {"a": {"run": float("nan")}, "b": {"run": 1}}}},
        "objectives.a.run: Input should be a finite number",
    ),
    "a huge weight": (
        {"task": {"objectives": {"a": {"run": 1e300}, "b": {"run": 1}}}},
        r"1e\+300 is too large: use at most 1e\+09",
    ),
    "a huge layer": ({"network": {"actor": (2**40,)}}, "network.actor.0"),
    "a formula": ({"task": {"objectives": {"=1+1": {}, "b": {}}}}, "cannot be '=1\\+1'"),
    "nesting": ({"task": {"objectives": {"a": {"run": [[[[[[[]]]]]]]}, "b": {}}}}, "valid number"),
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_unusable_values_are_refused_in_one_sentence(name):
    changes, expected = UNUSABLE[name]
    with pytest.raises(MorlaxError, match=expected) as error:
        load_config({"env": "cheetah", "worlds": 512, **changes})
    assert "\n" not in str(error.value) and len(str(error.value)) < 600


def test_a_copy_of_a_config_has_no_unknown_names():  # which pydantic would pass over
    config = config_for("cheetah", device="cpu")
    assert config.model_copy(update={"seed": 3}).seed == 3
    for values, name in ((config, "ppo.learning_rate"), (config.task, "episode_lenght")):
        with pytest.raises(MorlaxError, match=f"unknown key '{name}'"):
            values.model_copy(update={name: 1})


UNREADABLE = {
    "the same key twice": ("env: ant\nseed: 1\nseed: 2\n", "the key seed appears twice"),
    "no base": ("env: ant\nbase: x\n", "there is no configs/x.yaml"),
    "one GPU": ("env: ant\ngpus: {1: {seed: 2}}\n", "gpus.1.*greater than or equal to 2"),
    "a key for more GPUs than here": ("env: ant\ngpus: {8: {sed: 2}}\n", "mean 'seed'"),
    "deep nesting": ("a: " + "[" * 2000 + "]" * 2000, "is nested too deeply"),
    "binary": ("env: \0", "is not valid YAML"),
    "doubling": (
        "a: &a [x, x]\n" + "".join(f"a{i}: &a{i} [*a, *a]\n" for i in range(9)) + "env: ant\n",
        "unknown key 'a'",
    ),
}


@pytest.mark.parametrize("processes, seed, epochs", [(1, 1, 3), (2, 2, 3), (3, 2, 3), (4, 2, 9)])
def test_a_file_can_have_other_values_from_so_many_gpus_on(
    processes, seed, epochs, tmp_path, monkeypatch
):
    monkeypatch.setattr(config_files, "PROCESSES", processes)
    file = tmp_path / "x.yaml"
    file.write_text(
        "env: ant\nseed: 1\nppo: {epochs: 3, clip: 0.3}\n"
        "gpus: {4: {ppo: {epochs: 9}}, 2: {seed: 2}}\ncpu: {seed: 5}\n"
    )
    config = load_config(file_values(file, "cuda"))
    assert (config.seed, config.ppo.epochs, config.ppo.clip) == (seed, epochs, 0.3)
    assert load_config(file_values(file, "cpu")).seed == 5


# options that repair what is wrong with the base that they change
REPAIRED = {
    "minibatches of a file": ("ppo: {minibatches: 7}", ("--ppo.minibatches", "8")),
    "no limit": ("max_env_steps: null\ndecay_fraction: 0.3", ("--max-seconds", "9")),
    "an unknown objective": ("scalarization: constrained:x", ("--scalarization", "linear")),
    "a network": ("network: {type: independent}", ("--network.type", "dual")),
    "an algorithm": ("network: {type: single}", ("--algorithm", "hyper-morl")),
}


@pytest.mark.parametrize("name", REPAIRED)
def test_options_are_checked_together_with_the_file_that_they_change(name, tmp_path):
    text, options = REPAIRED[name]
    file = tmp_path / "my.yaml"
    file.write_text(f"env: hopper\n{text}\n")
    typed = ["--config", str(file), "--device", "cpu"]
    if name != "an algorithm":  # which alone is valid
        with pytest.raises(MorlaxError):
            read(typed)
    assert read([*typed, *options])[0] == load_config(read([*typed, *options])[0].model_dump())


@pytest.mark.parametrize("env", ["cheetah", "walker", "hopper", "ant", "humanoid"])
def test_several_gpus_make_as_many_updates_of_twice_the_samples(env, monkeypatch):
    updates, samples = [], []
    for processes in (1, 2, 4):
        monkeypatch.setattr(config_files, "PROCESSES", processes)
        config = load_config(task_values(env, "cuda"))
        samples.append(config.worlds * processes * config.horizon)
        updates.append(config.max_env_steps / samples[-1])
    assert updates[0] == updates[1] == updates[2]
    assert samples[0] * 2 == samples[1] == samples[2]


@pytest.mark.parametrize("name", UNREADABLE)
def test_unreadable_files_are_refused_in_one_sentence(name, tmp_path):
    text, expected = UNREADABLE[name]
    (tmp_path / "x.yaml").write_text(text)
    with pytest.raises(MorlaxError, match=expected) as error:
        read(["--config", str(tmp_path / "x.yaml"), "--device", "cpu"])
    assert "\n" not in str(error.value) and len(str(error.value)) < 2000


def test_a_long_name_of_a_task_is_read_from_the_record_of_a_run(tmp_path):
    name = f"{tmp_path}/{'a folder with spaces/' * 6}robot.py:Robot"
    write_record(config_for("hopper").model_copy(update={"env": name}), tmp_path)
    assert task_of(tmp_path) == name
