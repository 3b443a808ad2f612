"""The command line: options, and a plain error message for each mistake."""

import shutil
import sys
from pathlib import Path

import pytest
import torch
from programs import python
from tiny import TYPED

from morlax_torch import load, save
from morlax_torch.commands import evaluate, export, record, train
from morlax_torch.commands.terminal import cli
from morlax_torch.configuration.config import Config


def run(monkeypatch, module, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", [module.__name__, *arguments])
    cli.run(module.command)


@pytest.mark.parametrize("words", [("--resume", ""), ("--env", "hopper", "--start-from", "")])
def test_an_empty_argument_does_not_name_the_newest_run(words, trained, refused):
    assert "an argument is empty" in refused(train, *words, "--device", "cpu")


@pytest.fixture(scope="module")
def once(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("once") / "run"
    train.command(["--env", "hopper", *TYPED, "--output", str(folder)])
    return folder


@pytest.fixture
def trained(workplace: Path, once: Path) -> Path:
    return shutil.copytree(once, workplace / "run")


def sentence(capsys) -> str:
    captured = capsys.readouterr()
    text = " ".join((captured.out + captured.err).split())
    assert "Traceback" not in text
    return text


def read(*arguments: str) -> Config:
    return train.read(arguments)[0]


def test_options_override_the_config_file_which_overrides_task_defaults(workplace):
    Path("my.yaml").write_text("env: ant\nppo: {learning_rate: 0.01, clip: 0.3}\nhorizon: 7\n")
    config = read("--config", "my.yaml", "--device", "cpu", "--ppo.learning-rate", "1e-4")
    assert (config.env, config.horizon, config.ppo.clip) == ("ant", 7, 0.3)
    assert config.ppo.learning_rate == 1e-4


def test_a_cpu_gets_fewer_worlds_than_a_gpu(monkeypatch):
    on_cpu = read("--env", "cheetah", "--device", "cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    on_gpu = read("--env", "cheetah")
    assert on_cpu.worlds < on_gpu.worlds
    assert (on_cpu.device, on_cpu.backend) == ("cpu", "mujoco")
    assert (on_gpu.device, on_gpu.backend) == ("cuda:0", "warp")


def test_a_config_file_can_regroup_objectives(workplace):
    Path("my.yaml").write_text(
        "env: hopper\n"
        "task:\n"
        "  objectives: {fast: {run: 1.5}, high: {jump: 12}, upright: {upright: 4}}\n"
        "  shared: {alive: 1}\n"
    )
    config = read("--config", "my.yaml", "--device", "cpu")
    assert tuple(config.task.objectives) == ("fast", "high", "upright")
    assert config.num_corners(3) == 3
    assert read("--env", "hopper", "--task.shared.alive", "2").task.shared["alive"] == 2


MISTAKES = {
    "no task": ((), "name a task: --env NAME, one of ant, bruce"),
    "unknown task": (("--env", "chetah"), "did you mean 'cheetah'?"),
    "unknown flag": (("--env", "ant", "--ppo.learning-rat", "1"), "--ppo.learning-rate"),
    "unknown flag's help": (("--env", "ant", "--horizn", "1"), "train --env NAME --help-all"),
    "wrong type": (("--env", "ant", "--worlds", "many"), "many"),
    "negative": (("--env", "ant", "--ppo.learning-rate", "-1"), "ppo.learning_rate"),
    "K does not divide N": (("--env", "ant", "--worlds", "100"), "must divide worlds (100)"),
    "no GPU": (("--env", "ant", "--device", "cuda"), "no CUDA device"),
    "no device": (("--env", "ant", "--device", "gpu"), "'gpu' is not a device"),
    "no config file": (("--config", "none.yaml"), "there is no config none.yaml"),
    "resume nothing": (("--resume", "nowhere"), "nowhere is not a run"),
}


@pytest.mark.skipif(torch.cuda.is_available(), reason="one of the mistakes is to have no GPU")
@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_prints_one_error_and_creates_nothing(name, workplace, monkeypatch, capsys):
    arguments, expected = MISTAKES[name]
    with pytest.raises(SystemExit) as exit:
        run(monkeypatch, train, *arguments)
    assert exit.value.code == 2
    text = sentence(capsys).replace("│ ", "").replace("- ", "-")
    assert expected in text
    assert not list(workplace.iterdir())


FILES = {
    "unknown key": ("env: ant\nhorzion: 3\n", "unknown key 'horzion': did you mean 'horizon'?"),
    "unknown task option": ("env: ant\ntask: {njmx: 3}\n", "did you mean 'njmax'?"),
    "unknown reward term": (
        "env: ant\ntask: {objectives: {a: {vx: 1}, b: {vz: 1}}}\n",
        "unknown reward term 'vz'",
    ),
    "no task": ("worlds: 3\n", "names no task"),
    "no YAML": ("env: [ant\n", "is not valid YAML"),
    "no mapping": ("- 3\n", "must hold keys and values"),
}


@pytest.mark.parametrize("name", FILES)
def test_a_mistake_in_a_config_file_prints_one_error(name, workplace, refused):
    text, expected = FILES[name]
    Path("my.yaml").write_text(text)
    assert expected in refused(train, "--config", "my.yaml", "--device", "cpu")


def test_a_config_file_of_another_task_works_like_its_copy(workplace, capsys):
    text = "env: ant\nhorizon: 7\ntask: {reset_noise: 0.1}\ncpu: {worlds: 64}\n"
    Path("ant.yaml").write_text(text)
    Path("hopper.yaml").write_text(text.replace("ant", "hopper"))
    copied = read("--config", "hopper.yaml", "--device", "cpu")
    assert not capsys.readouterr().out
    assert read("--config", "ant.yaml", "--env", "hopper", "--device", "cpu") == copied
    assert capsys.readouterr().out == "ant.yaml is for ant: its values are used for hopper\n"
    assert (copied.env, copied.horizon, copied.worlds) == ("hopper", 7, 64)


def test_values_that_do_not_fit_another_task_are_one_sentence(workplace, refused):
    Path("my.yaml").write_text("env: ant\ntask: {objectives: {a: {vx: 1}, b: {vy: 1}}}\n")
    typed = ("--config", "my.yaml", "--env", "bruce", "--device", "cpu")
    assert "unknown reward term 'vx'" in refused(train, *typed)


def test_a_folder_in_use_is_not_overwritten(trained, refused):
    typed = ("--env", "hopper", *TYPED, "--output", "run")
    line = refused(train, *typed)
    assert "run exists already" in line and "continue the run with --resume run" in line


@pytest.mark.parametrize(
    ("output", "expected"),
    [
        ("file/run", "cannot make file/run"),
        ("file", "file exists already: choose another --output."),
        (".", ". exists already: choose another --output."),
    ],
)
def test_an_output_that_cannot_be_a_run_is_an_error(output, expected, workplace, refused):
    Path("file").write_text("")
    assert expected in refused(train, "--env", "hopper", *TYPED, "--output", output)


def test_a_resumed_run_keeps_its_config(trained, monkeypatch, capsys, refused):
    run(monkeypatch, train, "--resume", "run", "--max-env-steps", "640")
    assert "640 steps" in sentence(capsys)
    said = "a resumed run keeps its config (ppo.clip: 0.5 instead of 0.2)"
    assert said in refused(train, "--resume", "run", "--ppo.clip", "0.5")
    said = "a resumed run keeps its config (algorithm: amor instead of morlax)"
    assert said in refused(train, "--resume", "run", "--algorithm", "amor")
    for option in ("config", "output"):
        said = f"leave out --{option}"
        assert said in refused(train, "--resume", "run", f"--{option}", "other")


def test_evaluate_prints_the_indicators_of_a_run_that_cannot_be_written(
    trained, monkeypatch, capsys
):
    (trained / "report.html").mkdir()
    with pytest.raises(SystemExit) as exit:
        run(monkeypatch, evaluate, "run", "--device", "cpu", "--tradeoffs", "5")
    assert exit.value.code == 2
    captured = capsys.readouterr()
    assert "hypervolume" in captured.out and "cardinality" in captured.out
    assert captured.err.startswith("error: cannot write run/report.html")
    assert captured.err.count("\n") == 1


@pytest.mark.parametrize("module", [export, record])
def test_trade_offs_are_counted_before_a_task_is_imported(module, workplace, refused):
    file = workplace / "policy.pt"
    save(load("hopper"), file)
    contents = torch.load(file)
    contents["config"]["env"] = "mjlab:missing_module:Task"
    torch.save(contents, file)
    words = "needs 2 numbers (run, jump), not 3."
    assert words in refused(module, file, "--tradeoff", "0.5,0.5,1")


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 900 GiB"), "900 GiB more"),
        (RuntimeError("Failed to allocate 9000000 bytes on device 'cuda:0'"), "1.0 of 8.0 GiB"),
        (MemoryError(), "the memory is full"),
    ],
)
def test_running_out_of_memory_suggests_fewer_worlds(error, expected, monkeypatch, capsys):
    def full(_: object) -> None:
        raise error

    on_gpu = not isinstance(error, MemoryError)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: on_gpu)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda: (2**30, 2**33))
    with pytest.raises(SystemExit) as exit:
        cli.run(full)
    assert exit.value.code == 2
    text = sentence(capsys)
    assert expected in text and "use fewer --worlds" in text


def test_an_internal_error_is_not_hidden():
    def wrong(_: object) -> None:
        raise RuntimeError("CUDA error: an illegal memory access was encountered")

    with pytest.raises(RuntimeError, match="illegal"):
        cli.run(wrong)


def test_the_script_finds_a_module_in_the_current_folder(tmp_path):
    (tmp_path / "mine.py").write_text("raise RuntimeError('mine was imported')")
    script = "from morlax_torch.__main__ import main; main()"
    words = "train", "--env", "gymnasium:mine:Task-v0", "--trust"
    done = python("-P", "-c", script, *words, cwd=tmp_path)  # without this folder, as `morlax`
    assert done.returncode == 2 and "mine was imported" in done.stderr
