"""Tests that need an NVIDIA GPU; without one they are skipped with the reason."""

import sys
from pathlib import Path

import pytest
import torch

from napari_deltamic.fourier.cuda import missing

TESTS = Path(__file__).parents[1]
sys.path += [str(TESTS / "fourier"), str(TESTS / "stability")]  # what tests on the host


def pytest_collection_modifyitems(items):
    reason = missing()
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.gpu)
            if reason:
                item.add_marker(pytest.mark.skip(reason=f"the GPU is not used: {reason}"))


@pytest.fixture
def gpu():
    """The device."""
    return torch.device("cuda", torch.cuda.current_device())
