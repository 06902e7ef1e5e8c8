"""``napari-deltamic batch``: many fits, one table, resumed where it was stopped."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from .. import __version__
from ..common.choices import ZARR
from ..common.writing import make_folder, own_folder, write_atomically
from ..errors import InputError
from ..results.batch_tables import DONE, FAILED, is_done, write_tables
from ..runs.batch import BatchJob, batch_jobs
from .arguments.batch_arguments import fit_words
from .cluster import default_workers, outcomes
from .messages import Notes, tell

_WANTED = "batch.json"  # in a job's folder: what was asked for


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Fit what is not done yet, and print the paths of the tables."""
    folder = Path(arguments.output).absolute()
    jobs = batch_jobs(arguments.source, arguments.seeds, fit_words(arguments))
    _check_options(jobs)
    workers = default_workers() if arguments.workers is None else arguments.workers
    with own_folder(folder):
        notes.release()
        left = [job for job in jobs if not _done_before(job, folder)]
        done = len(jobs) - len(left)
        if done:
            print(f"{done} of {len(jobs)} are done already", file=sys.stderr)
        failed = 0
        rows = [(job.name, job.image.name) for job in jobs]
        try:
            for job, error in _under_way(left, folder, workers, arguments.scheduler):
                done, failed = done + 1, failed + bool(error)
                print(f"{done}/{len(jobs)} {job.name}: {error or 'done'}", file=sys.stderr)
        finally:
            paths = write_tables(folder, rows)
        for path in paths:
            tell(path)
    if failed:
        print(f"{failed} of {len(jobs)} could not be fitted: see summary.csv", file=sys.stderr)
    return 1 if failed else 0


def _under_way(
    jobs: Sequence[BatchJob], folder: Path, workers: int, scheduler: str | None
) -> Iterator[tuple[BatchJob, str]]:
    """Prepare the folders of jobs, run them, and yield each with its error ("" for none)."""
    for job in jobs:
        own = folder / job.name
        make_folder(own)
        for stale in (FAILED, DONE):  # left by another image or other options
            (own / stale).unlink(missing_ok=True)
        write_atomically(own / _WANTED, _wanted(job).encode())
    for job, error in outcomes(jobs, folder, min(workers, max(len(jobs), 1)), scheduler):
        if error:
            write_atomically(folder / job.name / FAILED, f"{error}\n".encode())
        yield job, error


def _done_before(job: BatchJob, folder: Path) -> bool:
    """Whether the folder holds results of exactly this job."""
    own = folder / job.name
    wanted = own / _WANTED
    if own.exists() and not wanted.is_file() and any(own.iterdir()):
        raise InputError(f"{own} holds files that are not of a batch: choose another folder")
    same = wanted.is_file() and wanted.read_text(encoding="utf-8") == _wanted(job)
    return same and is_done(own)


def _wanted(job: BatchJob) -> str:
    """All that the results depend on, as JSON."""
    facts = {
        "version": __version__,
        "words": job.words(Path("."))[:-2],
        "files": [_state(job.image), None if job.seeds is None else _state(Path(job.seeds))],
    }
    # Settings, and the image of a bead.
    named = [_state(Path(word)) for word in job.options if Path(word).is_file()]
    if named:
        facts["named"] = named
    return json.dumps(facts, indent=1) + "\n"


def _state(path: Path) -> list[int] | None:
    """Size (bytes) and time (ns) of a file, or total and latest of an OME-Zarr folder."""
    inside = path.rglob("*") if path.suffix.lower() == ZARR else [path]
    states = [file.stat() for file in inside if file.is_file()]
    if not states:
        return None
    return [sum(s.st_size for s in states), max(s.st_mtime_ns for s in states)]


def _check_options(jobs: Sequence[BatchJob]) -> None:
    """Raise InputError, before any work, for options that no fit takes, or missing seeds."""
    from . import build_parser

    for job in jobs:
        if job.seeds is None and "--settings" not in job.options:
            raise InputError(
                f"where does the fit of {job.name} start? give --seeds: a pattern such as "
                "'{stem}_labels.tif', or auto"
            )
    parser = build_parser()
    for options in dict.fromkeys(job.options for job in jobs):
        given = {option.partition("=")[0] for option in options}
        for word in ("-o", "--output", "--resume", "-h", "--help"):
            if word in given:
                raise InputError(f"{word} is not for a batch: each image has a folder of its own")
        parser.parse_args(["fit", "image.tif", *options, "-o", "folder"])
