"""Standard errors of a PSF that is fitted with the shape."""

import numpy as np
import pytest

from napari_deltamic import FitState, InputError, PupilPSF
from napari_deltamic.evidence.modes import shape_modes
from napari_deltamic.evidence.psf_errors import psf_standard_errors
from napari_deltamic.optics import ScalarPSF
from synthetic import GRID, OPTICS, TRUTH


def state(optics=OPTICS):
    density = np.ones(len(TRUTH.faces))
    return FitState(1, 1, 1, TRUTH, optics, density, 0.1, 1.0, 2.0, 1.0)


def test_errors_grow_with_the_noise():
    few, many = (psf_standard_errors(state(), GRID, v) for v in (4.0, 1.0))
    assert set(few) == {"sigma_z", "sigma_y", "sigma_x"}
    for name in few:
        assert few[name] == pytest.approx(2 * many[name], rel=1e-6)


def test_a_free_shape_makes_the_psf_less_certain():
    narrow = psf_standard_errors(state(), GRID, 1.0, modes=shape_modes(TRUTH, count=2))
    wide = psf_standard_errors(state(), GRID, 1.0, modes=shape_modes(TRUTH, count=40))
    assert all(wide[name] > narrow[name] for name in wide)


def test_errors_are_named_after_what_is_fitted():
    psf = PupilPSF(0.8, 0.52, 1.0, {5: 0.1, 7: 0.2}, fitted=("z7",), extent=(1.0, 1.0))
    assert list(psf_standard_errors(state(psf), GRID, 1.0)) == ["z7"]


def test_what_cannot_be_told_is_refused():
    with pytest.raises(InputError, match="no fitted parameter"):
        psf_standard_errors(state(ScalarPSF(0.8, 0.52, 1.0, fitted=())), GRID, 1.0)
    with pytest.raises(InputError, match="variance"):
        psf_standard_errors(state(), GRID, 0.0)
