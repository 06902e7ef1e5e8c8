"""One session of random actions in the window, in a process of its own; see ``window``."""

from __future__ import annotations

import json
import os
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

from .window_actions import actions
from .window_session import Session


def main(seed: int, count: int, longest: float, cycles: int) -> None:
    """Play, open and close the dock, and write what went wrong as it happens."""
    offscreen = os.environ.get("QT_QPA_PLATFORM") == "offscreen"
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        session = Session(seed, Path(folder), offscreen=offscreen)
        session.play(actions(session), count, longest)
        session.open_and_close(cycles)
        print("did " + json.dumps(session.did), flush=True)
        # What napari and Qt do while they are taken down is no part of the experiment.
        os._exit(0)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]))
