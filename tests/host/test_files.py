"""Atomic files: what they replace, and what they refuse to replace."""

import os
import stat
import subprocess
import sys

import pytest

from morlax_torch import MorlaxError
from morlax_torch.host.files import Taken, making, remove_drafts, replacing


def write(path, text: bytes = b"new") -> None:
    with replacing(path) as file:
        file.write(text)


def test_a_symbolic_link_stays_and_its_target_is_replaced(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("old")
    link.symlink_to(target)
    write(link)
    assert link.is_symlink() and target.read_text() == "new"


def test_new_files_get_the_permissions_of_the_umask(tmp_path):
    usual = os.umask(0o027)
    try:
        write(tmp_path / "file")
    finally:
        os.umask(usual)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o640


def test_devices_pipes_and_folders_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for path in ("/dev/null", tmp_path / "pipe", tmp_path / "folder"):
        with pytest.raises(MorlaxError, match="not a regular file"):
            write(tmp_path / path)
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


@pytest.mark.parametrize("name", ["x" * 300, "loop/file"])
def test_an_impossible_path_is_one_sentence(name, tmp_path):
    with pytest.raises(MorlaxError, match="cannot write"):
        write(tmp_path / "missing" / "file")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(MorlaxError, match="cannot write"):
        write(tmp_path / name)
    with pytest.raises(MorlaxError), making(tmp_path / name):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == ["loop"]


@pytest.mark.parametrize("error", (OSError(28, "No space left"), ValueError(), KeyboardInterrupt()))
def test_a_failure_leaves_the_old_file_and_nothing_else(error, tmp_path):
    path = tmp_path / "file"
    path.write_text("old")
    expected = MorlaxError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected), replacing(path) as file:
        file.write(b"half")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_drafts_of_killed_processes_are_removed_and_others_kept(tmp_path):
    killed = subprocess.Popen([sys.executable, "-c", "pass"])
    killed.wait()
    for name in (f".{killed.pid}.abc.tmp", f".{os.getpid()}.abc.tmp", ".hidden.tmp", "file"):
        (tmp_path / name).touch()
    remove_drafts(tmp_path)
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == sorted((f".{os.getpid()}.abc.tmp", ".hidden.tmp", "file"))


def test_a_folder_is_there_when_it_is_complete_or_not_at_all(tmp_path):
    folder, killed = tmp_path / "new" / "a[1].b", subprocess.Popen([sys.executable, "-c", "pass"])
    killed.wait()
    (tmp_path / "new" / f".a[1].b.{killed.pid}.abc.tmp" / "half").mkdir(parents=True)
    with pytest.raises(ZeroDivisionError), making(folder) as draft:
        (draft / "file").touch()
        raise ZeroDivisionError
    assert list((tmp_path / "new").iterdir()) == []
    with making(folder) as draft:
        (draft / "file").touch()
        assert not folder.exists()
    assert [path.name for path in (tmp_path / "new").rglob("*")] == ["a[1].b", "file"]


def test_a_folder_that_another_program_makes_meanwhile_is_kept(tmp_path):
    with pytest.raises(Taken, match="exists already"), making(tmp_path / "run") as draft:
        (draft / "mine").touch()
        with making(tmp_path / "run") as other:
            (other / "theirs").touch()
    assert [path.name for path in tmp_path.rglob("*")] == ["run", "theirs"]
