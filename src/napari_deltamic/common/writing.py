"""Files that appear whole or not at all, alone or together; folders that a run has to itself."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import secrets
import shutil
import signal
import stat
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Any

from ..errors import InputError

_TEMPORARY = re.compile(r"\.deltamic-([0-9a-f]{8})-(\d+)-[0-9a-f]{16}\.tmp")
_FORGOTTEN = 86400.0  # s: age of an abandoned temporary file, where processes cannot be asked for
_LOCK = ".deltamic.lock"

# Temporary files and the targets they replace at the end; None: each file at once.
_together: ContextVar[list[tuple[Path, Path]] | None] = ContextVar("_together", default=None)


def write_atomically(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file under another name in the same folder, then rename it.

    A reader never sees half a file. A file that is replaced keeps its permissions; a link stays a
    link.

    Raises
    ------
    InputError
        If it cannot be written, or the path exists and is not a file. What was there is then
        unchanged.
    """
    path = Path(path)
    try:
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            raise InputError(f"{path}: cannot be written: it is not a file")
        temporary = _written(target, data)
        batch = _together.get()
        if batch is not None:
            batch.append((temporary, target))
            return
        try:
            temporary.replace(target)
        finally:
            _forget(temporary)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise _unwritable(path, error) from error


def write_if_possible(path: Path, text: str) -> None:
    """Write what is kept for later runs; that it cannot be written is no reason to fail."""
    with suppress(OSError, InputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.encode())


@contextmanager
def written_together(last: str | os.PathLike[str]) -> Iterator[None]:
    """Files written within the block replace older ones at its end, all of them or none.

    Parameters
    ----------
    last
        Path of the one file that describes the others: its old version is removed before the first
        file is replaced, its new version comes after all others. So whenever the process is killed,
        it never lies beside files that it does not describe.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    batch: list[tuple[Path, Path]] = []
    token = _together.set(batch)
    try:
        yield
        end = Path(os.path.realpath(last))
        batch.sort(key=lambda pair: pair[1] == end)
        with interrupts_held():
            end.unlink(missing_ok=True)
            for temporary, target in batch:
                temporary.replace(target)
    except OSError as error:
        raise _unwritable(Path(last).parent, error) from error
    finally:
        _together.reset(token)
        for temporary, _ in batch:
            _forget(temporary)


@contextmanager
def folder_atomically(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A folder to write to; at the end it takes the place of the one at ``path`` as a whole.

    Raises
    ------
    InputError
        If it cannot be written. What was there is then unchanged.
    """
    path = Path(path)
    aside = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
    try:
        yield aside
        with interrupts_held():
            if path.exists():
                shutil.rmtree(path)
            aside.rename(path)
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back until the end of the block; it only ever reaches the main thread."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is None:
        yield
        return
    came: list[Any] = []
    signal.signal(signal.SIGINT, lambda *told: came.append(told))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came and callable(before):
            before(*came[0])


def make_folder(folder: str | os.PathLike[str]) -> None:
    """Make a folder and its parents; InputError if that, or writing to it, fails."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _forget(_written(folder / "probe", b""))
    except (OSError, ValueError) as error:
        raise _unwritable(folder, error) from None


@contextmanager
def own_folder(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Make a folder, and lock it against other runs within the block.

    Files that a killed process left half written are removed; so is the folder at the end, if it
    was made here and is still empty.

    Raises
    ------
    InputError
        If it cannot be made or written to, or another run is writing to it.
    """
    folder = Path(folder)
    made = not folder.exists()
    make_folder(folder)
    lock = _locked(folder)
    try:
        _sweep(folder)
        yield
    finally:
        if lock is not None:
            os.close(lock)
        if made:
            with suppress(OSError):
                folder.rmdir()


def _locked(folder: Path) -> int | None:
    """Descriptor of a locked file, which the system unlocks when the process ends.

    None where the file system has no locks. InputError if another run holds the lock.
    """
    busy = InputError(f"{folder}: another run writes its results there")
    if sys.platform == "win32":
        try:
            # Deleted as soon as it is closed, also after a kill.
            return os.open(folder / _LOCK, os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_TEMPORARY)
        except FileExistsError:
            raise busy from None
        except OSError:
            return None
    import fcntl

    found = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(found, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(found)
        raise busy from None
    except OSError:  # a file system that knows no locks
        os.close(found)
        return None
    return found


def _sweep(folder: Path) -> None:
    """Remove files that killed processes on this machine left half written."""
    for path in folder.glob(".deltamic-*.tmp"):
        match = _TEMPORARY.fullmatch(path.name)
        if match and match[1] == _machine() and not _runs(int(match[2]), path):
            _forget(path)


def _runs(process: int, path: Path) -> bool:
    if sys.platform == "win32":  # where asking for a process may end it
        with suppress(OSError):
            return time.time() - path.stat().st_mtime < _FORGOTTEN
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _written(target: Path, data: bytes) -> Path:
    """A temporary file beside the target, with its permissions; on disk when this returns."""
    # A name of its own: one that holds the target's could be too long.
    name = f".deltamic-{_machine()}-{os.getpid()}-{secrets.token_hex(8)}.tmp"
    temporary = target.with_name(name)
    try:
        with temporary.open("xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        with suppress(OSError):  # there is none
            temporary.chmod(stat.S_IMODE(target.stat().st_mode))
    except BaseException:
        _forget(temporary)
        raise
    return temporary


def _forget(path: Path) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True)


@cache
def _machine() -> str:
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def _unwritable(path: Path, error: Exception) -> InputError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return InputError(f"{path}: cannot be written: {reason}")
