"""What is tried of the PSF on a few cells in a piece of the image holds for all."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting.few_cells import few_cells
from napari_deltamic.fitting.fit_objective import Terms
from napari_deltamic.fitting.fitted import Fitted
from napari_deltamic.fitting.level import Level
from napari_deltamic.fitting.light_cone import share_left
from napari_deltamic.fitting.preconditioner import Preconditioners
from napari_deltamic.fitting.rival_structures import begun, stepped
from napari_deltamic.fitting.schedule import Schedule
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.effects import Effects

GRID = nd.Grid((24, 50, 130), (0.2, 0.2, 0.2))
OPTICS = nd.GaussianPSF((0.3, 0.2, 0.2))
PLACES = [(2.4, y, x) for y in (3.0, 7.0) for x in np.arange(3.0, 24, 4.0)]


def of_cells(places, model="interface"):
    """Terms, fit and its image of cells that are all a little smaller than they are."""
    true = nd.Mesh.merge([sphere(at, 1.5, edge_length=0.3) for at in places])
    image = nd.simulate(nd.Scene((nd.Surface(true),), OPTICS), GRID, photons=50.0, seed=1).image
    start = nd.Mesh.merge([sphere(at, 1.4, edge_length=0.3) for at in places])
    settings = FitSettings(fit_psf=True, density=model)
    fitted = Fitted.begun(start, OPTICS, Effects(), model, "membrane")
    counted = np.ones(GRID.shape, bool)
    level = Level(image, counted, GRID, OPTICS, settings, Effects(), 1.0)
    terms = Terms(level, None, settings, Schedule(), True, True, True)
    objective = begun(terms, fitted, Preconditioners())
    return terms, objective.fitted, objective.now.rendered


def test_few_cells_are_taken_whole():
    given = of_cells(PLACES[:5])
    assert all(one is other for one, other in zip(few_cells(*given), given, strict=True))


@pytest.mark.parametrize("model", ["interface", "smooth", "uniform"])
def test_of_many_a_piece_tells_what_all_of_them_do(model):
    terms, fitted, image = of_cells(PLACES, model)
    log = fitted.shape.log_density
    if log is not None:  # one that tells where each number has gone
        log = np.linspace(-0.2, 0.2, len(log))
        fitted = fitted.retriangulated(fitted.shape.moved(fitted.mesh.vertices_numpy(), log))
    few_terms, few, piece = few_cells(terms, fitted, image)
    assert piece.shape == few_terms.level.grid.shape == tuple(few_terms.level.target.shape)
    assert piece.numel() < 0.8 * image.numel()

    wide = nd.GaussianPSF((0.45, 0.2, 0.2))
    whole, part = (
        begun(t, f.seen_through(wide), Preconditioners())
        for t, f in ((terms, fitted), (few_terms, few))
    )
    assert share_left(part, piece) == pytest.approx(share_left(whole, image), rel=0.15)
    # The same surfaces of the same brightness.
    here, there = few.mesh.vertices_numpy(), fitted.mesh.vertices_numpy()
    rows = [int(np.flatnonzero((there == at).all(1))[0]) for at in here]
    corners = map(tuple, fitted.mesh.faces.tolist())
    by_corners = dict(zip(corners, faces_of(fitted), strict=True))
    each = [by_corners[tuple(rows[i] for i in f)] for f in few.mesh.faces.tolist()]
    np.testing.assert_allclose(faces_of(few), each, rtol=1e-9)


def faces_of(fitted):
    return fitted.shape.face_densities()


def test_neighbours_of_the_few_stay_where_they_are():
    terms, fitted, image = of_cells(PLACES)
    few_terms, few, _ = few_cells(terms, fitted, image)
    pinned = few.shape.pinned
    assert 0 < pinned.sum() < len(pinned)
    rival, _ = stepped(begun(few_terms, few, Preconditioners()))
    moved = np.linalg.norm(rival.fitted.mesh.vertices_numpy() - few.mesh.vertices_numpy(), axis=1)
    assert moved[pinned].max() == 0
    assert np.median(moved[~pinned]) > 0.03
