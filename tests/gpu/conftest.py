"""Tests that need an NVIDIA GPU; without one they are skipped with the reason.

With ``DELTAMIC_STAND_IN=1`` they run without one, on the CPU with emulated kernels: that shows
whether the tests themselves are right, so that a GPU that is lent is not wasted.
"""

import os
import sys
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path

import pytest
import torch

from napari_deltamic.fourier.cuda import device, missing

TESTS = Path(__file__).parents[1]
sys.path += [str(TESTS / "fourier"), str(TESTS / "stability")]  # what tests on the host
STAND_IN = os.environ.get("DELTAMIC_STAND_IN") == "1"

if STAND_IN:
    from cuda_emulation import Emulated, engine

    from napari_deltamic.fitting.model import level

    fit = import_module("napari_deltamic.fitting.fit")  # the function of that name hides it

    # Before the tests import it.
    device.kernels = lambda device, single: Emulated(single)


def pytest_collection_modifyitems(items):
    reason = "" if STAND_IN else missing()
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.gpu)
            if reason:
                item.add_marker(pytest.mark.skip(reason=f"the GPU is not used: {reason}"))


@pytest.fixture
def gpu(monkeypatch, request):
    """The device."""
    if not STAND_IN:
        yield torch.device("cuda", torch.cuda.current_device())
        return
    for module in (fit, level):  # for settings that ask for CUDA
        monkeypatch.setattr(module, "choose_device", lambda asked="auto", voxels=None: _CPU)
    # Fits and images would take minutes with emulated kernels.
    with engine() if "closed_form" in request.node.path.name else nullcontext():
        yield _CPU


_CPU = torch.device("cpu")


@pytest.fixture
def cuda_itself(gpu):
    """For tests of what nothing can stand in for: streams, memory, the driver."""
    if STAND_IN:
        pytest.skip("needs a GPU itself")
    return gpu
