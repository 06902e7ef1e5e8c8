"""Wrong calls of the compiled functions: each must be refused, or do what it says and no more.

Valid arguments of every function are made, and one to three of them spoilt: other shapes, other
types, other numbers. Children make the calls, so that a crash ends one of them only. Around every
array that a call may write to lie numbers that must stay. With ``--sanitized`` the functions are
built once more with AddressSanitizer and UndefinedBehaviorSanitizer.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

from .sanitized import build, environment

BATCH = 200  # calls of a child
SECONDS = 20.0  # that a call may take


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Those of this experiment."""
    parser.add_argument("--count", type=int, default=1600, help="calls")
    parser.add_argument("--sanitized", action="store_true", help="build and use sanitizers")


def run(arguments: argparse.Namespace) -> int:
    """Make the calls and print what became of them."""
    folder = build() if arguments.sanitized else None
    found, troubles = attempt(arguments.count, arguments.seed, folder)
    said = ", ".join(f"{n} {what}" for what, n in sorted(found.items()))
    print(f"native: {arguments.count} wrong calls: {said}")
    for trouble in troubles:
        print(trouble)
    return int(bool(troubles))


def attempt(
    count: int, seed: int = 0, sanitized: Path | None = None
) -> tuple[Counter[str], list[str]]:
    """How many calls were refused or done, and what went wrong, a line each.

    sanitized : folder of the sanitized extensions; None for those that are installed.
    """
    found: Counter[str] = Counter()
    troubles: list[str] = []
    first = 0
    while first < count:
        stop = min(count, first + BATCH)
        command = [sys.executable, "-m", f"{__package__}.native_calls", str(seed), str(first)]
        command += [str(stop), str(SECONDS), str(sanitized or "")]
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            env=environment() if sanitized else dict(os.environ),
            timeout=SECONDS * BATCH,
            check=False,
        )
        lines = done.stdout.splitlines()
        for line in lines:
            number, what, text = line.split("\t", 2)
            if what != "begun":
                found[what] += 1
            if what == "wrong":
                troubles.append(f"call {number}: {text}")
        if done.returncode == 0:
            first = stop
            continue
        # The last line says which call it was that ended the child.
        number, _, text = lines[-1].split("\t", 2) if lines else (str(first), "", "")
        reason = done.stderr.strip()[-3000:] if sanitized else done.stderr.strip()[-600:]
        found["ended"] += 1
        troubles.append(
            f"call {number}: {text}: the process ended with {done.returncode}: {reason}"
        )
        first = int(number) + 1
    return found, troubles
