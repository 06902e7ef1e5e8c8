"""Files appear whole or not at all; folders are one run's."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from napari_deltamic import InputError
from napari_deltamic.common.writing import (
    _machine,
    interrupts_held,
    make_folder,
    own_folder,
    write_atomically,
    written_together,
)

posix = pytest.mark.skipif(sys.platform == "win32", reason="links and permissions of POSIX")


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_a_name_as_long_as_the_system_allows(tmp_path):
    path = tmp_path / ("n" * 251 + ".txt")
    write_atomically(path, b"text")
    assert path.read_bytes() == b"text"
    with pytest.raises(InputError, match="cannot be written"):
        write_atomically(tmp_path / ("n" * 256), b"text")
    assert names(tmp_path) == [path.name]


def test_a_folder_that_went_is_told_once(tmp_path, monkeypatch):
    """The clean-up has nothing to add to the reason."""

    def gone(path, *_, **__):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("pathlib.Path.replace", gone)
    monkeypatch.setattr("pathlib.Path.unlink", gone)
    with pytest.raises(InputError, match=r"file\.txt: cannot be written: Operation not permitted"):
        write_atomically(tmp_path / "file.txt", b"text")


@posix
def test_permissions_and_links_stay(tmp_path):
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_bytes(b"old")
    file.chmod(0o600)
    link.symlink_to(file)
    write_atomically(link, b"new")
    assert link.is_symlink()
    assert file.read_bytes() == b"new"
    assert file.stat().st_mode & 0o777 == 0o600


@posix
def test_only_files_are_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(InputError, match="not a file"):
            write_atomically(tmp_path / name, b"")


def test_all_or_none(tmp_path):
    for name in ("a", "report"):
        (tmp_path / name).write_bytes(b"old")

    def stopped():
        with written_together(tmp_path / "report"):
            write_atomically(tmp_path / "report", b"new")
            write_atomically(tmp_path / "a", b"new")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert names(tmp_path) == ["a", "report"]
    assert (tmp_path / "a").read_bytes() == (tmp_path / "report").read_bytes() == b"old"
    with written_together(tmp_path / "report"):
        write_atomically(tmp_path / "report", b"new")
        write_atomically(tmp_path / "a", b"new")
        assert (tmp_path / "a").read_bytes() == b"old"
    assert (tmp_path / "a").read_bytes() == (tmp_path / "report").read_bytes() == b"new"


def test_what_tells_of_the_others_is_never_older(tmp_path, monkeypatch):
    """Whenever a kill comes: the old report goes first, the new one comes last."""
    for name in ("a", "b", "report"):
        (tmp_path / name).write_bytes(b"old")
    seen, replace = [], type(tmp_path).replace

    def watched(path, target):
        seen.append((tmp_path / "report").exists())
        return replace(path, target)

    monkeypatch.setattr("pathlib.Path.replace", watched)
    with written_together(tmp_path / "report"):
        for name in ("report", "a", "b"):
            write_atomically(tmp_path / name, b"new")
    assert seen == [False, False, False]
    assert (tmp_path / "report").read_bytes() == b"new"


def test_a_folder_is_one_runs(tmp_path):
    with own_folder(tmp_path / "run"):
        with pytest.raises(InputError, match="another run"), own_folder(tmp_path / "run"):
            pass
        (tmp_path / "run" / "result").touch()
    with own_folder(tmp_path / "run"):
        pass
    assert names(tmp_path / "run") == ["result"]


def test_a_lock_goes_with_its_process(tmp_path):
    code = (
        "import os, sys; from napari_deltamic.common.writing import own_folder\n"
        "with own_folder(sys.argv[1]): os._exit(9)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False, timeout=120)
    assert done.returncode == 9
    with own_folder(tmp_path):
        pass


def test_a_folder_in_which_nothing_came_to_be_goes(tmp_path):
    with pytest.raises(InputError), own_folder(tmp_path / "run"):
        raise InputError("no")
    (tmp_path / "mine").mkdir()
    with own_folder(tmp_path / "mine"):
        pass
    assert names(tmp_path) == ["mine"]


@posix
def test_what_a_killed_process_left_goes(tmp_path):
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    rest = "-0123456789abcdef.tmp"
    old = f".deltamic-{_machine()}-{child.pid}{rest}"
    ours, others = f".deltamic-{_machine()}-{os.getpid()}{rest}", f".deltamic-00000000-1{rest}"
    for name in (old, ours, others):
        (tmp_path / name).touch()
    with own_folder(tmp_path):
        assert names(tmp_path) == sorted([ours, others])


def test_a_folder_that_is_a_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        make_folder(tmp_path / "file")
    with pytest.raises(InputError, match="cannot be written"):
        make_folder(tmp_path / "nul\0")


def test_ctrl_c_waits():
    # A job in the background of a shell is begun without the handler of Python.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        _interrupted()
    finally:
        signal.signal(signal.SIGINT, before)


def _interrupted():
    reached = []

    def stopped():
        with interrupts_held():
            signal.raise_signal(signal.SIGINT)
            reached.append(1)

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert reached == [1]
    inside = threading.Thread(target=lambda: reached.append(interrupts_held().__enter__()))
    inside.start()
    inside.join()
    assert reached == [1, None]
