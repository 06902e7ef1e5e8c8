"""Values against other software, where it is installed; none of it is a dependency."""

import numpy as np
import pytest
import torch

from napari_deltamic import optics

from .models import focal_shift

VOXEL, HALF, OVER = 0.05, 12, 9


def relative(found, expected):
    found, expected = found / found.max(), expected / expected.max()
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


def integrated(model, z):
    """Intensity on a plane of pixels, integrated over each as the oracle does."""
    offsets = (np.arange(OVER) - (OVER - 1) / 2) / OVER * VOXEL
    x = (np.arange(-HALF, HALF + 1)[:, None] * VOXEL + offsets).reshape(-1)
    r, where = np.unique(np.round(np.hypot(x[:, None], x), 12), return_inverse=True)
    found = model.intensity_at(torch.tensor(z), torch.tensor(r)).numpy()[:, where.reshape(-1)]
    n = 2 * HALF + 1
    return found.reshape(len(z), n, OVER, n, OVER).mean((2, 4))


@pytest.mark.parametrize("kind", ["scalar", "vectorial"])
@pytest.mark.parametrize(
    ("na", "sample_index", "depth"), [(1.3, 1.515, 0.0), (1.2, 1.4, 5.0), (1.3, 1.333, 2.0)]
)
def test_layers_against_psfmodels(kind, na, sample_index, depth):
    psfmodels = pytest.importorskip("psfmodels", reason="psfmodels is not installed")
    make = optics.GibsonLanniPSF if kind == "scalar" else optics.VectorialPSF
    model = make(na, 0.52, 1.515, sample_index, depth)
    z = np.linspace(-1, 1, 9)
    # There, planes are told from the coverslip, at the paraxial focus of the depth.
    shift = focal_shift(model) + depth - 150.0 + depth * (1 - 1.515 / sample_index) + 150.0
    other = {"scalar": psfmodels.scalar_psf, "vectorial": psfmodels.vectorial_psf}[kind]
    numbers = {"NA": na, "ni": 1.515, "ni0": 1.515, "ns": sample_index, "sf": OVER, "mode": 1}
    expected = other(z + shift, nx=2 * HALF + 1, dxy=VOXEL, pz=depth, wvl=0.52, params=numbers)
    assert relative(integrated(model, z), expected) < 1e-3


def test_pupil_against_pyotf():
    otf = pytest.importorskip("pyotf.otf", reason="pyotf is not installed")
    n, planes = 256, 8
    theirs = otf.HanserPSF(
        wl=0.52, na=0.85, ni=1.0, res=0.1, size=n, zres=0.3, zsize=planes, vec_corr="none"
    )
    z = np.asarray(theirs.zrange)
    model = optics.ScalarPSF(0.85, 0.52, 1.0)
    x = (np.arange(n) - n // 2) * 0.1
    r = np.hypot(x[:, None], x)[n // 2 - 10 : n // 2 + 11, n // 2 - 10 : n // 2 + 11]
    found = model.intensity_at(torch.tensor(z), torch.tensor(r.reshape(-1))).numpy()
    expected = theirs.PSFi[:, n // 2 - 10 : n // 2 + 11, n // 2 - 10 : n // 2 + 11]
    # Its pupil is cut by pixels.
    assert relative(found.reshape(expected.shape), expected) < 2e-2
