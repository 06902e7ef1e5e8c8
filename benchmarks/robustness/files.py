"""Damaged files: each must be read, or refused in one line, in bounded time and memory.

Good files of every kind are spoilt: bytes, numbers and words are replaced, parts cut out, repeated
or put in; members of archives are spoilt within, with sums that are right again. Readers get most
of them, the command line some, as image, seeds, settings or checkpoint of a fit.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections import Counter

BATCH = 250  # files of a child
SECONDS = 30.0  # that one may take
MEMORY = 4 << 30  # bytes that a child may take, libraries and all: address space


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Those of this experiment."""
    parser.add_argument("--count", type=int, default=5000, help="files for the readers")
    parser.add_argument("--commands", type=int, default=400, help="files for the command line")


def run(arguments: argparse.Namespace) -> int:
    """Spoil and read files, and print what became of them."""
    wrong = 0
    for what, count in (("reader", arguments.count), ("command", arguments.commands)):
        found, troubles = attempt(what, count, arguments.seed)
        said = ", ".join(f"{n} {word}" for word, n in sorted(found.items()))
        print(f"files: {count} spoilt files, {what}: {said}", flush=True)
        for trouble in troubles:
            print(trouble, flush=True)
        wrong += len(troubles)
    return int(bool(wrong))


def attempt(what: str, count: int, seed: int = 0) -> tuple[Counter[str], list[str]]:
    """How many files were read or refused, and what went wrong, a line each.

    what : ``reader`` or ``command``.
    """
    found: Counter[str] = Counter()
    troubles: list[str] = []
    first = 0
    while first < count:
        stop = min(count, first + BATCH)
        command = [sys.executable, "-m", f"{__package__}.files_read", what, str(seed), str(first)]
        command += [str(stop), str(SECONDS), str(MEMORY)]
        env = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(command, capture_output=True, text=True, env=env, check=False)
        number, text = str(first), "nothing"
        for line in done.stdout.splitlines():
            number, word, text = line.split("\t", 2)
            if word != "begun":
                found[word] += 1
            if word == "wrong":
                troubles.append(f"file {number}: {text}")
        if done.returncode == 0:
            first = stop
            if done.stderr.strip():
                troubles.append(f"files {first - BATCH}..{stop}: on stderr: {done.stderr[-600:]}")
            continue
        found["ended"] += 1
        troubles.append(
            f"file {number}: {text}: the process ended with {done.returncode}: {done.stderr[-600:]}"
        )
        first = int(number) + 1
    return found, troubles
