"""A fit that is resumed from a checkpoint remembers what it had seen and changed."""

import numpy as np
import pytest

from napari_deltamic import GaussianPSF, Grid, Mesh, fit, render
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.runs.settings import FitSettings

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
OPTICS, GRID = GaussianPSF(0.13), Grid((20, 20, 30), (0.1,) * 3)
SETTINGS = FitSettings(levels=(1.5, 1.0))


def balls(half, radius, edge):
    return Mesh.merge([sphere((0.95, 0.95, 1.45 + x), radius, edge) for x in (-half, half)])


@pytest.fixture(scope="module")
def whole(tmp_path_factory, one_thread):
    """The states of a fit in which two cells come to touch, its image and its checkpoints."""
    image = render(balls(0.5, 0.51, 0.1), GRID, OPTICS, 1e-4).numpy().astype(np.float64)
    folder = tmp_path_factory.mktemp("checkpoints")
    states = []
    for state in fit(image, GRID, balls(0.55, 0.45, 0.18), OPTICS, settings=SETTINGS):
        state.save(folder / f"{state.iteration}.npz")
        states.append(state)
    return states, image, folder


def told(states):
    return [(s.iteration, s.events) for s in states if s.events]


@pytest.mark.parametrize(
    "later",
    [
        k if k in (-1, 2) else pytest.param(k, marks=pytest.mark.slow)
        for k in (-12, -1, 0, 2, 12, 22)
    ],
)
def test_a_resumed_fit_goes_on_as_if_it_had_not_stopped(whole, later):
    states, image, folder = whole
    events = told(states)
    assert events  # or this shows nothing
    path = folder / f"{events[0][0] + later}.npz"
    start = balls(0.55, 0.45, 0.18)
    resumed = list(fit(image, GRID, start, OPTICS, settings=SETTINGS, resume=path))
    first = resumed[0].iteration
    assert told(resumed) == [e for e in events if e[0] >= first]
    last, other = states[-1], resumed[-1]
    assert other.iteration == last.iteration
    np.testing.assert_array_equal(other.mesh.faces, last.mesh.faces)
    np.testing.assert_allclose(other.mesh.vertices_numpy(), last.mesh.vertices_numpy(), atol=1e-9)
