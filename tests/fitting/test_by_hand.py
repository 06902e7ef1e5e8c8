import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting.by_hand import changed_by_hand, is_by_hand
from napari_deltamic.fitting.job import FitInput
from napari_deltamic.fitting.model.change import Change
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene.light import INSIDES

GRID = nd.Grid((16, 16, 16), (0.2, 0.2, 0.2))
OPTICS = nd.GaussianPSF((0.24, 0.24, 0.24))
BALL = sphere((1.6, 1.6, 1.6), 0.8, edge_length=0.3)


@pytest.fixture(scope="module")
def job():
    settings = RunSettings(
        image="", seeds="", scene=SceneSettings(voxel_size=GRID.voxel_size), fit=FitSettings()
    )
    image = np.ones(GRID.shape, np.float32)
    return FitInput(settings, image, GRID, BALL, OPTICS, None)


def a_state(**facts):
    known = 3, 1, 1, BALL, OPTICS, np.ones(len(BALL.faces)), 0.1, 2e4, 5.0, 1.0
    return nd.FitState(*known, light=INSIDES, grid=GRID, accuracy=1e-3, **facts)


def test_it_shows_the_surface_as_it_was_put(job):
    state = a_state()
    larger = Change(mesh=BALL.with_vertices(1.6 + 1.3 * (BALL.vertices_numpy() - 1.6)))
    changed = changed_by_hand(state, job, larger)
    assert is_by_hand(changed)
    assert not is_by_hand(state)
    seen, before = changed.rendered() - 5.0, state.rendered() - 5.0
    assert seen.sum() / before.sum() == pytest.approx(1.3**3, rel=0.01)


def test_an_image_that_was_known_before_is_not_shown_after(job):
    state = a_state()
    shown = state.showing(state.rendered())
    assert shown.rendered() is shown.rendered()
    moved = Change(mesh=BALL.with_vertices(BALL.vertices_numpy() + 0.2))
    changed = changed_by_hand(shown, job, moved)
    assert not np.allclose(changed.rendered(), shown.rendered(), atol=0.1)


def test_dark_nuclei_stay_dark(job):
    dimmed = np.ones(GRID.shape, np.float32)
    dimmed[7:9, 7:9, 7:9] = 0.25
    even, changed = (
        changed_by_hand(a_state(dimmed=d), job, Change(optics=OPTICS)).rendered()
        for d in (None, dimmed)
    )
    np.testing.assert_allclose(changed - 5.0, dimmed * (even - 5.0), rtol=1e-5)
