"""What is as large as an image stays on the device: vertices and a few numbers go to the host.

Seen on the CPU, by the operations that a copy to the host would be.
"""

import sys
import threading
from collections import Counter
from pathlib import Path

import pytest
import torch
from torch.overrides import TorchFunctionMode

import napari_deltamic as nd
from napari_deltamic.fitting.model import likelihood
from napari_deltamic.fitting.objective.posterior import Posterior
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings

PACKAGE = Path(nd.__file__).parent
READS = {"__array__", "cpu", "item", "numpy", "tolist", "__float__", "__bool__", "__int__"}
GRID, OPTICS = nd.Grid((24, 24, 24), (0.2, 0.2, 0.2)), nd.GaussianPSF(0.3)
TRUTH = sphere((2.4, 2.3, 2.3), 1.2, subdivisions=2)
START = sphere((2.3, 2.3, 2.3), 1.0, subdivisions=2)
LARGE = 3 * len(START.vertices)  # what a gradient by vertices has; images and transforms have more


def caller():
    """The file of the package that the present call comes from."""
    frame = sys._getframe(2)
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        if PACKAGE in path.parents:
            return str(path.relative_to(PACKAGE))
        frame = frame.f_back
    return None


class Reads(TorchFunctionMode):
    """Counts what is read of tensors, by file of the package and size."""

    def __init__(self):
        super().__init__()
        self.large, self.small = Counter(), Counter()

    def __torch_function__(self, func, types, args=(), kwargs=None):
        name = getattr(func, "__name__", "")
        read = name in READS and args and isinstance(args[0], torch.Tensor)
        # The loops of the CPU take arrays: a device has its own.
        if read and (place := caller()) and not place.startswith("fourier/"):
            kind = self.large if args[0].numel() > LARGE else self.small
            kind[f"{place}: {name}"] += 1
        return func(*args, **(kwargs or {}))


def read_in_each_evaluation(monkeypatch, **settings):
    """What each evaluation of the objective read."""
    found, evaluate, here = [], Posterior.__call__, threading.get_ident()

    def counted(self, at):
        if threading.get_ident() != here:  # what a window closed before has not ended yet
            return evaluate(self, at)
        with Reads() as reads:
            evaluation = evaluate(self, at)
        found.append(reads)
        return evaluation

    monkeypatch.setattr(Posterior, "__call__", counted)
    # A device has no loop that explains an image in one go.
    monkeypatch.setattr(likelihood, "compiled", lambda device: False)
    image = nd.render(TRUTH, GRID, OPTICS, 1e-2)
    given = FitSettings(accuracy=1e-2, levels=(1.0,), max_iterations=8, **settings)
    list(nd.fit(image, GRID, START, OPTICS, settings=given))
    return found


@pytest.mark.parametrize("density", ["uniform", "interface", "smooth"])
@pytest.mark.parametrize("fit_psf", [False, True])
def test_an_evaluation_reads_no_image(monkeypatch, density, fit_psf):
    found = read_in_each_evaluation(monkeypatch, density=density, fit_psf=fit_psf)
    assert len(found) >= 8
    assert not [reads.large for reads in found if reads.large]
    for reads in found:
        # Five numbers of the match in one go, the value, and the gradients.
        assert reads.small["fitting/model/likelihood.py: tolist"] == 1
        assert sum(reads.small.values()) <= 24, reads.small


def test_reads_are_seen():
    """Or the tests above show nothing."""
    with Reads() as reads:
        list(
            nd.fit(
                nd.render(TRUTH, GRID, OPTICS, 1e-2),
                GRID,
                START,
                OPTICS,
                settings=FitSettings(accuracy=1e-2, levels=(1.0,), max_iterations=1),
            )
        )
    assert reads.large
