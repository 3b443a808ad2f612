"""Try every command of the installed package in an empty folder: `python smoke.py`."""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import urllib.request
from pathlib import Path

from morlax_torch.__main__ import COMMANDS

TINY = (
    *("--device", "cpu", "--worlds", "8", "--horizon", "4", "--sampling.clusters", "4"),
    *("--ppo.minibatches", "1", "--evaluation.tradeoffs", "4", "--task.episode-length", "20"),
)
ROBOT = """
<mujoco>
  <worldbody>
    <body name="arm">
      <joint name="shoulder"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder"/>
  </actuator>
</mujoco>
"""
LINES = {
    "new": ("arm.xml",),
    "train": ("--env", "cheetah", *TINY, "--max-env-steps", "64", "--output", "run"),
    "evaluate": ("run", "--device", "cpu"),
    "choose": ("run", "--maximize", "energy"),
    "design": ("bodies", "--bodies", "4", "--tradeoffs", "2", "--rounds", "1", "--population", "4"),
    "record": ("run", "--output", "strip.png", "--seconds", "0.1", "--pictures", "2"),
    "export": ("run", "--tradeoff", "0.7,0.3"),
    "pack": ("run", "small", "--device", "cpu"),
}
BODIES = (
    *("--env", "design/hopper", *TINY, "--sampling.designs", "4", "--evaluation.designs", "2"),
    *("--max-env-steps", "64", "--output", "bodies"),
)
WRITTEN = {
    "arm.py",
    *("run/front.npz", "run/report.html", "strip.png", "run/policy.onnx"),
    "small/front.npz",
    "bodies/designs/body.xml",
}


def main() -> None:
    # play needs the export of a task of mjlab, which tests/viewers/test_mjlab_play.py has
    assert {*LINES, "explore", "play"} == set(COMMANDS), "a command is not tried"
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        Path("arm.xml").write_text(ROBOT)
        for name, arguments in [("train", BODIES), *LINES.items()]:
            subprocess.run([sys.executable, "-m", "morlax_torch", name, *arguments], check=True)
        for path in WRITTEN:
            assert Path(path).is_file(), f"{path} is missing"
        explore()


def explore() -> None:
    """Open the page of a shipped policy, and end its server with Ctrl-C."""
    words = [sys.executable, "-m", "morlax_torch", "explore", "cheetah", "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        first = server.stdout.readline()
        print(first, end="")
        with urllib.request.urlopen(first.split()[1]) as page:
            assert b"<html" in page.read()
        server.send_signal(signal.SIGINT)
        assert server.wait(timeout=60) == 0


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    main()
