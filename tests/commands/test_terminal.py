"""In a terminal of 80 columns, no line of output or help is longer, and none is cut."""

import errno
import io
import os
import sys
from typing import Any

import pytest
import torch
from pydantic import BaseModel
from rich.console import Console
from rich.text import Text
from tiny import TYPED, tiny

from morlax_torch import config_for, envs
from morlax_torch.__main__ import COMMANDS, command
from morlax_torch.algorithms.registry import LEARNERS
from morlax_torch.commands.terminal import arguments, cli, display
from morlax_torch.commands.terminal.arguments import text_of
from morlax_torch.configuration.config import Config, config_class, flat
from morlax_torch.host.phases import phase, within
from morlax_torch.runs.progress import read_rows
from morlax_torch.train import train

COLUMNS = 80
SMALL = (
    *("--env", "bruce", "--device", "cpu", "--worlds", "32", "--horizon", "2"),
    *("--sampling.clusters", "16", "--ppo.minibatches", "1", "--evaluation.tradeoffs", "6"),
    *("--max-env-steps", "128", "--evaluation.every", "64", "--task.episode-length", "4"),
)
SHOWN = {
    "train": ("--env", "--config", "--resume", "--output", "--seed", "--max-seconds"),
    "evaluate": ("RUN", "--tradeoffs", "--protocol", "--output"),
    "record": ("RUN", "--tradeoff", "--output", "--seconds", "--speed", "--width", "--pictures"),
    "export": ("RUN", "--tradeoff", "--format", "--output", "--slew", "torch-export"),
    "play": ("EXPORT", "--episodes", "--seconds", "--delay", "--noise", "--push", "--friction"),
}


def assert_fits(lines: list[str]) -> None:
    assert any(lines)
    for line in lines:
        assert len(line) <= COLUMNS, line
        assert "…" not in line, line


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_every_command_fits_and_names_the_command(name, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    monkeypatch.setattr(sys, "orig_argv", ["python", "/venv/bin/morlax", name, "--help"])
    with pytest.raises(SystemExit) as ended:
        command([name, "--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert_fits(text.splitlines())
    assert text.startswith(f"usage: morlax {name} ")
    assert "(default: None)" not in text and "(default: )" not in text  # texts say what None means
    for option in SHOWN.get(name, ()):
        assert option in text
    if name == "train":
        assert text.count("\n  --") == 21
        assert all(f"{task}," in text or f"{task}." in text for task in envs.names())


def test_the_whole_help_lists_every_option(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    typed = ("--env", "hopper", "--algorithm", "hyper-sac", "--device", "cpu")
    with pytest.raises(SystemExit) as ended:
        command(["train", *typed, "--help-all"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert_fits(text.splitlines())
    for name in flat(config_for("hopper", algorithm="hyper-sac", device="cpu").model_dump()):
        assert f"--{name.replace('_', '-')}" in text or name.startswith("task.")


def test_a_run_at_its_limit_says_which_option_to_raise(workplace, capsys):
    run = train(tiny(), output=workplace / "run")
    before = (run.folder / "metrics.csv").read_bytes()
    command(["train", "--resume", "run"])
    said = "run has reached its limit: raise --max-env-steps to train it further.\n"
    assert capsys.readouterr().out == said
    assert (run.folder / "metrics.csv").read_bytes() == before
    assert run.limit_reached(tiny(max_env_steps=65)) is None
    assert run.limit_reached(tiny(max_env_steps=None, max_seconds=1e-9)) == "max-seconds"
    latest = run.checkpoints / "latest.pt"
    contents = torch.load(latest)
    contents["progress"]["evaluated"] = False
    torch.save(contents, latest)
    assert run.limit_reached(tiny()) is None  # the last evaluation is missing


def test_a_run_of_seconds_says_that_it_is_evaluated_only_at_its_end(tmp_path, capsys):
    limits = "--max-seconds", "0.1", "--max-env-steps", "1_000_000_000"
    command(["train", "--env", "hopper", *TYPED, *limits, "--output", str(tmp_path / "run")])
    text = capsys.readouterr().out
    assert text.count("training takes less than 10 s, so it is evaluated only at its end\n") == 1
    (row,) = read_rows(tmp_path / "run" / "metrics.csv")
    assert float(row["train_seconds"]) >= 0.1 and row["best"] == "1"


def test_training_tells_once_what_may_help(tmp_path, capsys, monkeypatch):
    said, hint = "No policy exceeds the reference point", "--algorithm hyper-sac may find a front"
    monkeypatch.setattr(display, "SLOW", 0.0)
    command(["train", "--env", "cheetah", *SMALL[2:], "--output", str(tmp_path / "cheetah")])
    usual = capsys.readouterr().out
    assert said not in usual and hint not in usual
    monkeypatch.setattr(display, "SLOW", 1e9)
    option = "--task.reference-point", "0", "4e4", "--output", str(tmp_path / "hopper")
    command(["train", "--env", "hopper", *SMALL[2:], *option])
    lines = capsys.readouterr().out.splitlines()
    assert sum(hint in line for line in lines) == 1
    first, last = (place for place, line in enumerate(lines) if said in line)
    assert "(run 0, jump 40000)" in lines[first] and "--task.reference-point 0 " in lines[first]
    assert lines[last - 1].startswith("done: ")
    (untrained,) = (n for n, x in enumerate(lines) if x.split()[:2] == ["0", "0.0"])
    assert first > untrained + 1  # which need not exceed it


def test_the_output_of_training_fits(workplace, monkeypatch):
    output = io.StringIO()
    terminal = Console(file=output, force_terminal=True, width=COLUMNS, legacy_windows=False)
    monkeypatch.setattr(display, "console", terminal)
    command(["train", *SMALL, "--output", "run"])
    lines = Text.from_ansi(output.getvalue()).plain.splitlines()
    assert_fits(lines)
    assert any(line.startswith("done: 128 steps") for line in lines)


def test_a_terminal_gets_moving_lines_and_a_pipe_none(monkeypatch):
    for terminal in (True, False):
        output = io.StringIO()
        console = Console(file=output, force_terminal=terminal, width=80, legacy_windows=False)
        monkeypatch.setattr(cli, "console", console)
        with cli.Live(), within("ant"):
            phase("filming", 0.25)
        assert ("ant: filming 25%" in output.getvalue()) == terminal


def undescribed(model: type[BaseModel], prefix: str = "") -> list[str]:
    """Return the options without a text."""
    found = []
    for name, field in model.model_fields.items():
        kind: Any = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            found += undescribed(kind, f"{prefix}{name}.")
        elif not (text_of(model, name) or text_of(Config, name)):
            found.append(prefix + name)
    return found


@pytest.mark.parametrize("env", envs.names())
def test_every_option_has_a_text(env):
    models = [arguments.Train]
    models += [config_class(env, name) for name in LEARNERS]
    for model in models:
        assert not undescribed(model)


def test_names_in_brackets_are_printed_as_they_are(workplace, capsys):
    name = "hopper[lr=1e-3][/b] x"
    command(["train", "--env", "hopper", *SMALL[2:], "--output", name])
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith(name) for line in lines)
    assert lines[-1].startswith("next: ") and lines[-1].endswith(f"evaluate '{name}'")


def test_a_name_is_printed_where_the_output_lacks_its_letters(monkeypatch):
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, "ascii"))
    cli.run(lambda words: cli.console.print("runs/Läufe"))
    assert written.getvalue() == rb"runs/L\xe4ufe" + os.linesep.encode()


def test_commands_work_where_their_output_is_closed(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)  # as Python does
    monkeypatch.setattr(sys, "stderr", None)
    cli.run(lambda words: cli.console.print("done"))
    with pytest.raises(SystemExit, match="2"):
        cli.run(lambda words: cli.fail("a mistake"))


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_an_output_that_is_full_is_one_sentence(number, monkeypatch, capsys):
    def printing(words: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(cli, "_silence_output", lambda: None)  # that pytest captures
    with pytest.raises(SystemExit, match="2"):
        cli.run(printing)
    assert capsys.readouterr().err.startswith("error: cannot print: no space left")
