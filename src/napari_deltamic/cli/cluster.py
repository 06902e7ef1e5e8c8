"""Jobs on processes of this machine, or on those of a Dask cluster."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import resource_tracker
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from ..common import seldom_collected
from ..common.writing import interrupts_held
from ..errors import PROGRAM, Failure, InputError, one_line
from ..results.batch_tables import DONE
from ..runs.batch import BatchJob
from .messages import INTERRUPTED

# s within which a scheduler must answer: a busy one takes seconds, a missing one never would
_PATIENCE = 20.0
_ENVIRONMENT, _PROFILE = (  # of Dask's configuration
    "distributed.nanny.pre-spawn-environ",
    "distributed.worker.profile.enabled",
)
_TURN = 0.2  # s between looks for Ctrl-C while waiting, where Ctrl-C does not end the wait

_log = logging.getLogger(__name__)


def fit_in_folder(words: Sequence[str]) -> str:
    """Run one command in this process; returns what went wrong in one line, or "".

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted; it has then ended in good order, as when run on its own.
    """
    from . import main  # imported only in the process that does the work

    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            code = main(list(words))
    except Exception:  # whatever it is, the others go on
        return traceback.format_exc(limit=-1).strip().splitlines()[-1]
    if code == INTERRUPTED:
        raise KeyboardInterrupt
    start = f"{PROGRAM}: error: "
    lines = [line for line in said.getvalue().splitlines() if line.startswith(start)]
    return "" if code == 0 else (lines or [f"it ended with code {code}"])[-1].removeprefix(start)


def outcomes(
    jobs: Sequence[BatchJob], folder: Path, workers: int, scheduler: str | None
) -> Iterator[tuple[BatchJob, str]]:
    """Run the jobs; yields each as it ends, with what went wrong ("" for nothing).

    Parameters
    ----------
    folder
        Folder in which each job has a folder of its name.
    workers
        Number of processes on this machine; 0 for this process alone, which needs no Dask.
    scheduler
        Address of a running Dask scheduler, whose workers see the same files; used instead of
        processes of this machine.

    Raises
    ------
    InputError
        If Dask is not installed, or the scheduler does not answer.
    Failure
        If the scheduler is lost before all jobs have ended.
    KeyboardInterrupt
        At Ctrl-C, whatever else goes wrong then.
    """
    if workers == 0 and scheduler is None:
        for job in jobs:
            try:
                error = fit_in_folder(job.words(folder / job.name))
            except KeyboardInterrupt:  # what it wrote is no result: the next run fits it again
                (folder / job.name / DONE).unlink(missing_ok=True)
                raise
            yield job, error
        return
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise InputError(
            "several processes need Dask: pip install 'napari-deltamic[many]'; --workers 0 does "
            "without"
        ) from None
    with _client(workers, scheduler) as client:
        futures = {
            client.submit(fit_in_folder, job.words(folder / job.name), pure=False): job
            for job in jobs
        }
        for future in _as_they_end(list(futures)):
            if future.cancelled():  # only a lost connection does that
                raise Failure(
                    "the connection to the scheduler was lost; what is finished is kept, and the "
                    "same command goes on from there"
                )
            error = future.exception()
            # A worker that died over and over, say: its image failed, the others go on.
            yield futures[future], _in_words(error) if error else future.result()


def _as_they_end(futures: Sequence[Any]) -> Iterator[Any]:
    """Dask's futures in the order in which they end.

    Ctrl-C is put in the same queue. As an exception at whatever line is running it could be lost:
    what a destructor or a callback of a library raises is dropped.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C was pressed meanwhile, even after the last one has ended.
    """
    ended: SimpleQueue[Any] = SimpleQueue()
    for future in futures:
        future.add_done_callback(ended.put)
    with _first_interrupt_in(ended):
        for _ in futures:
            yield _next(ended)
        if not ended.empty():
            raise KeyboardInterrupt


def _next(ended: SimpleQueue[Any]) -> Any:
    while True:
        with contextlib.suppress(Empty):
            future = ended.get(timeout=_TURN)
            break
    if future is None:
        raise KeyboardInterrupt
    return future


@contextlib.contextmanager
def _first_interrupt_in(queue: SimpleQueue[Any]) -> Iterator[None]:
    """Within the block, the first Ctrl-C puts None into the queue; a second acts as usual."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def put(*told: object) -> None:
        signal.signal(signal.SIGINT, before)
        queue.put(None)

    before = signal.signal(signal.SIGINT, put)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _in_words(error: BaseException) -> str:
    """Why a job has no result at all."""
    if type(error).__name__ == "KilledWorker":
        return "each process that fitted it was killed; it may need more memory than there is"
    return one_line(f"{type(error).__name__}: {error}")


@contextlib.contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    from distributed import Client

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=_PATIENCE)
        except (OSError, ValueError, TimeoutError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"the scheduler {scheduler} does not answer: {reason}") from None
        with _closed(client):
            if not client.scheduler_info()["workers"]:
                print(f"{scheduler} has no workers yet: waiting for the first", file=sys.stderr)
            yield client
        return
    with contextlib.ExitStack() as opened:
        with interrupts_held():  # until what was started is certain to be closed as well
            cluster = opened.enter_context(_closed(_local_cluster(workers)))
        yield opened.enter_context(_closed(Client(cluster)))


def _local_cluster(workers: int) -> Any:
    """A Dask cluster of one-thread processes on this machine; none listens to other machines.

    Two defaults of Dask are switched off: a profiler that stops each process a hundred times a
    second, and returning freed memory at once (see ``freed_memory``). Measured: small fits by one
    process then took 1.3 to 2.0 s instead of 1.5 to 2.6.

    The processes ignore Ctrl-C, which a terminal sends to all of them: each would end with a
    traceback, and this process ends them anyway. They inherit that from the thread that starts
    them.
    """
    import dask
    from distributed import LocalCluster

    def start() -> Any:
        if sys.platform != "win32":
            resource_tracker.ensure_running()  # starting it later would unblock signals again
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        environment = dict(dask.config.get(_ENVIRONMENT))
        environment.pop("MALLOC_TRIM_THRESHOLD_", None)
        with dask.config.set({_ENVIRONMENT: environment, _PROFILE: False}):
            return LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                memory_limit=0,
                preload=[seldom_collected.__name__],
                silence_logs=logging.CRITICAL,  # they log what Ctrl-C cut short; failures are told
            )

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(start).result()


@contextlib.contextmanager
def _closed(opened: Any) -> Iterator[Any]:
    """Close a Dask object at the end; if that fails, the outcomes of the jobs are not lost."""
    try:
        yield opened
    finally:
        try:
            opened.close()
        except Exception:
            _log.warning("%r does not close", opened, exc_info=True)


def default_workers() -> int:
    """The number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
