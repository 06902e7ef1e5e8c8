"""Whether an image shows the cone of light of an objective."""

from functools import cache

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.evidence.light_cone import objective_of
from napari_deltamic.evidence.predicted_error import predicted_error
from napari_deltamic.evidence.verdict import CellFacts, Facts, judged
from napari_deltamic.fitting.job import FitInput
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings

SIZE, SHAPE = (0.2, 0.1, 0.1), (24, 36, 36)
ABOUT = (0.3, 0.11, 0.11)  # um; widths of the PSF of NA 1.2 in water at 0.6 um
MIDDLE = (2.3, 1.75, 1.75)
OBJECTIVE = nd.ScalarPSF(1.2, 0.6, 1.33)


@cache
def ended(optics):
    """A fit of a cell seen through some PSF, as a Gaussian that may change, and its end."""
    grid = nd.Grid(SHAPE, SIZE)
    image = nd.render(sphere(MIDDLE, 1.1, edge_length=0.15), grid, optics).numpy()
    image = np.random.default_rng(0).poisson(5 + 100 * image / image.max()).astype(np.float32)
    start, gaussian = sphere(MIDDLE, 1.0, edge_length=0.3), nd.GaussianPSF(ABOUT)
    scene = SceneSettings(voxel_size=SIZE, sigma=ABOUT)
    fitting = FitSettings(fit_psf=True, structure="auto")
    *_, state = nd.fit(image, grid, start, gaussian, settings=fitting)
    run = RunSettings(image="", seeds="", scene=scene, fit=fitting)
    return FitInput(run, image, grid, start, gaussian, None), state


@pytest.mark.parametrize(("optics", "shown"), [(OBJECTIVE, True), (nd.GaussianPSF(ABOUT), False)])
def test_an_objective_is_told_from_a_gaussian(optics, shown):
    found = predicted_error(*ended(optics))
    assert found.unknown == ""
    assert found.cone is shown


def test_a_psf_that_is_held_is_not_asked():
    job, state = ended(OBJECTIVE)
    held = job.settings.fit.model_copy(update={"fit_psf": False})
    assert not predicted_error(job.with_settings(fit=held), state).cone


def test_a_fit_through_the_wrong_kind_of_psf_is_fair():
    cells = (CellFacts(1, 0.9),)
    facts = Facts(finished=True, explained=0.9, cells=cells)
    assert judged(facts).grade == "good"
    found = judged(Facts(True, 0.9, cells=cells, error=type(facts.error)(cone=True)))
    assert found.grade == "fair"
    assert "--modality" in found.sentence()
    assert found.as_plain()["error"]["cone"]


@pytest.mark.parametrize("aperture", [0.5, 0.9, 1.2])
def test_the_objective_is_about_as_wide(aperture):
    # Widths by the formulas that the module names, so that only their inverse is tested here.
    across = 0.22 * 0.5 / aperture
    along = 0.88 * 0.5 / (1.33 - np.sqrt(1.33**2 - aperture**2)) / 2.3548
    found = {p.name: p.value for p in objective_of((along, across, across)).described()}
    assert found["na"] == pytest.approx(aperture, rel=1e-9)
    assert found["wavelength"] == pytest.approx(0.5, rel=1e-9)


def test_no_light_makes_a_psf_of_ten_micrometres():
    with pytest.raises(InputError):
        objective_of((30, 10, 10))
