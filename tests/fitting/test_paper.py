"""The paper's own way of fitting."""

import numpy as np
import pytest

from napari_deltamic import Change, GaussianPSF, InputError, fit
from napari_deltamic.runs.settings import FitSettings
from synthetic import GRID, OPTICS, apart, fitted, measured, start

PAPER = FitSettings(as_in_the_paper=True, max_iterations=200)


def test_it_finds_the_sphere():
    last = fitted(measured(), start(2), settings=PAPER)
    assert last.iteration == 200
    assert "as in the paper" in last.message
    assert apart(last.mesh) < 0.1


@pytest.mark.slow
def test_it_finds_the_psf():
    settings = PAPER.model_copy(update={"fit_psf": True})
    last = fitted(measured(), start(2), optics=GaussianPSF(0.17), settings=settings)
    np.testing.assert_allclose(last.optics.sigma_um, OPTICS.sigma_um, rtol=0.1)


def test_it_takes_neither_effects_nor_changes():
    image = measured()
    with pytest.raises(InputError, match="has no effects"):
        fitted(image, start(2), settings=PAPER, effects=("halo",))
    states = fit(image, GRID, start(2), OPTICS, settings=PAPER)
    state = next(states)
    with pytest.raises(InputError, match="takes no changes"):
        states.send(Change(mesh=state.mesh))
