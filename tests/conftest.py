"""What several tests need."""

import os
import signal
import tempfile
from pathlib import Path

# Tests run several at a time: a thread each, or they wait for one another. Before torch is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
import torch

# A shell that starts the tests in the background has them ignore Ctrl-C, and so the programs that
# they start, which are to be interrupted.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Costs that a user's machine has kept are no business of the tests, nor theirs of the user's.
_CACHE = tempfile.TemporaryDirectory()
os.environ["DELTAMIC_CACHE"] = _CACHE.name


def shared_data_folder() -> Path:
    """Where real images and meshes lie, if anywhere; DELTAMIC_DATA overrides the default."""
    default = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    return Path(os.environ.get("DELTAMIC_DATA", default))


def pytest_collection_modifyitems(items):
    """What waits for windows, threads and processes is tried once more before it fails.

    A rerun is told in the summary. Nothing of the engine gets one: its bits are always the same.
    """
    for item in items:
        if {"gui", "cli", "robustness"} & set(Path(item.path).parts):
            item.add_marker(pytest.mark.flaky(reruns=1))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real images and meshes; tests that ask for it skip where it is absent."""
    folder = shared_data_folder()
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder} (set DELTAMIC_DATA to say where it is)")
    return folder


@pytest.fixture(scope="module")
def one_thread():
    """For what is compared bit by bit: sums over several threads differ in their last bits."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def a_picture() -> bytes:
    """Of no fit in particular, for tests that do not look at it: to draw one takes long."""
    import numpy as np

    from napari_deltamic import Grid
    from napari_deltamic.geometry import sphere
    from napari_deltamic.results.picture import picture_png

    grid = Grid((4, 4, 4), (0.3, 0.2, 0.2))
    nothing = np.zeros(grid.shape)
    return picture_png(nothing, nothing, sphere((0.5, 0.3, 0.3), 0.2, edge_length=0.2), grid)
