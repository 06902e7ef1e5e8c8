"""Random actions of a user in the window: nothing may be raised, hang, or be lost.

Children play: each opens napari with the widget, and does some hundred things in any order, also
such as make no sense, while fits, previews, checks and sessions are under way. What is raised
anywhere is counted, the time of every action is measured, and after each it is looked whether what
the user has is still there: the image, the seeds, the result of the last fit, what a session holds.
The last child opens and closes the dock, and looks for what that leaves behind.
Without a display, as real canvases of napari crash by themselves where layers are removed fast.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections import Counter

BATCH = 400  # actions of a child
LONGEST = 20.0  # s that an action may keep the window: no machine is that slow
START = 120.0  # s for a child to start


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Those of this experiment."""
    parser.add_argument("--count", type=int, default=4000, help="actions")
    parser.add_argument("--cycles", type=int, default=50, help="times that the dock is closed")
    parser.add_argument("--minutes", type=float, default=30.0, help="after which it ends")
    parser.add_argument("--display", action="store_true", help="in a window; no layer is removed")


def run(arguments: argparse.Namespace) -> int:
    """Play, and print what came of it."""
    end, first = time.monotonic() + 60 * arguments.minutes, 0
    did: Counter[str] = Counter()
    troubles: list[str] = []
    while first < arguments.count and time.monotonic() < end:
        n = min(BATCH, arguments.count - first)
        cycles = arguments.cycles if first + n == arguments.count else 0
        seed = arguments.seed + first // BATCH
        found, own = play(seed, n, cycles, display=arguments.display)
        did.update(found)
        troubles += own
        first += n
        print(f"{first} actions, {len(troubles)} troubles", flush=True)
    for trouble in troubles:
        print(trouble)
    counted = ", ".join(f"{n} {name}" for name, n in sorted(did.items()))
    print(f"window: {first} random actions ({counted}): {len(troubles)} troubles")
    return int(bool(troubles) or first < arguments.count)


def play(
    seed: int, count: int, cycles: int = 0, *, display: bool = False
) -> tuple[dict[str, int], list[str]]:
    """What a child did, counted, and what went wrong, a line or a traceback each."""
    words = [sys.executable, "-X", "faulthandler", "-m", f"{__package__}.window_child"]
    environment = dict(os.environ)
    if not display:
        environment["QT_QPA_PLATFORM"] = "offscreen"
    try:
        done = subprocess.run(
            [*words, str(seed), str(count), str(LONGEST), str(cycles)],
            capture_output=True,
            text=True,
            env=environment,
            timeout=START + count * 2.0 + cycles * 10.0,
        )
    except subprocess.TimeoutExpired as error:
        last = (error.stdout or b"").decode(errors="replace").splitlines()[-1:]
        return {}, [f"seed {seed}: hangs after {last}"]
    lines = done.stdout.splitlines()
    troubles = [f"seed {seed}: {json.loads(line[6:])}" for line in lines if line[:6] == "wrong "]
    if "Timeout (" in done.stderr and troubles:
        troubles.append(done.stderr[done.stderr.index("Timeout (") :][:3000])
    ends = [json.loads(line[4:]) for line in lines if line[:4] == "did "]
    if done.returncode or not ends:
        tail = "\n".join([*lines[-3:], *done.stderr.splitlines()[:30]])
        troubles.append(f"seed {seed}: ended with {done.returncode}\n{tail}")
    return (ends[0] if ends else {}), troubles
