"""Batches on several processes: of a cluster, killed ones, and a scheduler that is gone."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from napari_deltamic.cli import cluster, main
from napari_deltamic.errors import Failure
from napari_deltamic.images.stacks import read_image, write_image

pytest.importorskip("distributed")
pytestmark = pytest.mark.skipif(
    not Path("/proc/self/stat").is_file(), reason="the processes of Linux are needed"
)
FAST = ("--max-iterations", "2", "--sigma", "0.36", "0.24", "0.24")
SEEDS = ("--seeds", "{stem}_seeds.ply")


@pytest.fixture(scope="module")
def stacks(data, tmp_path_factory):
    """Four images with their seeds."""
    folder = tmp_path_factory.mktemp("stacks")
    pixels, size = read_image(data / "cell.tif")
    for name in "abcd":
        write_image(folder / f"{name}.tif", pixels + ord(name), size)
        (folder / f"{name}_seeds.ply").write_bytes((data / "start.ply").read_bytes())
    return folder


def child(*words, **more):
    return subprocess.Popen(
        [sys.executable, *map(str, words)], text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, env={**os.environ, "OMP_NUM_THREADS": "1"}, **more,
    )  # fmt: skip


def words(stacks, out, *more):
    return ["batch", str(stacks), *SEEDS, *more, "-o", str(out), *FAST]


@pytest.fixture(scope="module")
def alone(stacks, tmp_path_factory):
    """The tables of one process without Dask."""
    out = tmp_path_factory.mktemp("alone") / "out"
    assert main(words(stacks, out, "--workers", "0")) == 0
    return tables(out)


def tables(folder):
    return [(folder / name).read_text() for name in ("summary.csv", "cells.csv")]


@pytest.fixture
def blocked(stacks, tmp_path):
    """The stacks with a last one whose seeds are a pipe: it waits for as long as the test wants."""
    folder = tmp_path / "stacks"
    shutil.copytree(stacks, folder)
    (folder / "d_seeds.ply").unlink()
    os.mkfifo(folder / "d_seeds.ply")
    return folder


def wait_until_read(pipe, process):
    """Until somebody has opened a pipe; it then waits for what is written there."""
    while process.poll() is None:
        try:
            return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
        except OSError:  # no reader yet
            time.sleep(0.05)
    raise AssertionError(process.communicate()[1])


def unblock(folder):
    """The seeds are a file like the others."""
    (folder / "new.ply").write_bytes((folder / "a_seeds.ply").read_bytes())
    (folder / "new.ply").replace(folder / "d_seeds.ply")


def workers_of(process):
    """Process ids of the workers below a process."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == process and b"spawn_main" in (folder / "cmdline").read_bytes():
                found.append(int(folder.name))
        except (OSError, ValueError, IndexError):
            continue
    return found


def state():
    """Of the process that it runs in: what decides how fast a fit is."""
    import gc

    import dask

    profiled = dask.config.get("distributed.worker.profile.enabled")
    freed_at_once = "MALLOC_TRIM_THRESHOLD_" in os.environ
    return gc.get_threshold()[0], profiled, freed_at_once, os.environ.get("OPENBLAS_NUM_THREADS")


def test_workers_fit_as_fast_as_the_command_alone(monkeypatch):
    monkeypatch.delenv("MALLOC_TRIM_THRESHOLD_", raising=False)
    with cluster._client(1, None) as client:
        assert client.submit(state).result(timeout=60) == (50_000, False, False, "1")


@pytest.mark.usefixtures("judged")
@pytest.mark.slow
def test_a_worker_that_is_killed_is_replaced(blocked, alone, tmp_path):
    out = tmp_path / "out"
    with child("-m", "napari_deltamic", *words(blocked, out, "--workers", "1")) as process:
        end = wait_until_read(blocked / "d_seeds.ply", process)
        (worker,) = workers_of(process.pid)
        unblock(blocked)
        os.kill(worker, signal.SIGKILL)
        os.close(end)
        said = process.communicate()[1]
    assert process.returncode == 0, said
    assert tables(out) == alone


@pytest.mark.usefixtures("judged")
@pytest.mark.slow
def test_a_scheduler_that_is_gone(blocked, alone, tmp_path, capsys):
    """What is finished is kept, the end is one sentence, and the next run needs no scheduler."""
    out = tmp_path / "out"
    with child(Path(__file__).with_name("small_cluster.py"), stdin=subprocess.PIPE) as scheduler:
        more = ("--scheduler", scheduler.stdout.readline().strip())
        with child("-m", "napari_deltamic", *words(blocked, out, *more)) as process:
            end = wait_until_read(blocked / "d_seeds.ply", process)
            scheduler.kill()
            said = process.communicate()[1].splitlines()
        os.close(end)
    assert process.returncode == 1, said
    assert said[-1].startswith("napari-deltamic: error: the connection to the scheduler was lost")
    assert [line for line in said if line.endswith(": done")] == said[:-1]
    with (out / "summary.csv").open() as stream:
        status = {row["name"]: row["status"] for row in csv.DictReader(stream)}
    assert status == {"a": "ended", "b": "ended", "c": "ended", "d": "not done"}
    unblock(blocked)
    assert main(words(blocked, out, "--workers", "0")) == 0
    assert "3 of 4 are done already" in capsys.readouterr().err
    assert tables(out) == alone


class Future:
    """One whose worker died over and over."""

    def add_done_callback(self, told):
        told(self)

    def cancelled(self):
        return False

    def exception(self):
        from distributed.scheduler import KilledWorker

        return KilledWorker("fit", None, 3)


def test_an_image_that_kills_its_workers_fails_alone(monkeypatch, tmp_path):
    from napari_deltamic.runs.batch import BatchJob

    monkeypatch.setattr(cluster, "_client", lambda *a: FakeClient())
    job = BatchJob("a", tmp_path / "a.tif", "auto", ())
    ((found, error),) = cluster.outcomes([job], tmp_path, 1, None)
    assert found is job
    assert "killed" in error
    monkeypatch.setattr(Future, "cancelled", lambda self: True)
    with pytest.raises(Failure, match="what is finished is kept"):
        list(cluster.outcomes([job], tmp_path, 1, None))


class FakeClient:
    def __enter__(self):
        return self

    def __exit__(self, *told):
        pass

    def submit(self, *arguments, **options):
        return Future()


class Interrupting:
    """Ctrl-C while it is destroyed, where Python drops every exception."""

    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def test_ctrl_c_is_not_lost_at_any_line(monkeypatch, tmp_path):
    """Not in a destructor, and not when the processes do not close in good order either."""
    from napari_deltamic.runs.batch import BatchJob

    class Unclosable(FakeClient):
        def close(self):
            raise TimeoutError

    monkeypatch.setattr(Future, "exception", lambda self: None)
    monkeypatch.setattr(Future, "result", lambda self: "", raising=False)
    monkeypatch.setattr("distributed.Client", lambda *a, **k: Unclosable())
    monkeypatch.setattr(cluster, "_local_cluster", lambda workers: Unclosable())
    before = signal.getsignal(signal.SIGINT)
    for ended in (1, 2):  # with one left, and with none
        jobs = [BatchJob(name, tmp_path / name, "auto", ()) for name in "ab"]
        outcomes = cluster.outcomes(jobs, tmp_path, 1, None)
        assert [next(outcomes) for _ in range(ended)] == [(job, "") for job in jobs[:ended]]
        Interrupting()
        with pytest.raises(KeyboardInterrupt):
            for _ in outcomes:
                pass
        assert signal.getsignal(signal.SIGINT) is before
