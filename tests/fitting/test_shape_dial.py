"""The dial: what names and lengths stand for, and what is predicted of them."""

from dataclasses import replace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting.job import assemble
from napari_deltamic.fitting.model.default_accuracy import accuracy_for
from napari_deltamic.fitting.shape_dial import Situation, dialled, with_edges
from napari_deltamic.fitting.surface.triangle_quality import Remeshing
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings

SIZE = (0.2, 0.2, 0.2)
BALL = sphere((3.0, 3.0, 3.0), 2.0, edge_length=0.6)
GRID = nd.Grid((30, 30, 30), SIZE)
NOW = Situation.of(BALL, GRID, (0.26, 0.26, 0.26), 0.046)


def test_a_situation_is_read_from_start_and_image():
    assert pytest.approx(1.97, abs=0.03) == NOW.radius
    assert (NOW.voxel, NOW.width) == (pytest.approx(0.2), pytest.approx(0.26))
    # About what spheres and tori of 40 photons showed, once triangles were fine: 10 nm.
    assert NOW.fixed() == pytest.approx(0.0105, abs=0.001)


def test_rims_of_clusters_add_to_what_is_predicted():
    pair = foam(np.array([[3.0, 3.0, 1.5], [3.0, 3.0, 4.5]]), np.array([2.0, 2.0]), 0.3)
    cluster = Situation.of(pair, GRID, (0.26, 0.26, 0.26), 0.046)
    rim = 2 * np.pi * np.sqrt(2.0**2 - 1.5**2)  # of spheres of 2 um whose centres are 3 um apart
    outside = 2 * 2 * np.pi * 2.0 * (2.0 + 1.5)
    wall = np.pi * (2.0**2 - 1.5**2)
    assert cluster.rims == pytest.approx(rim * 0.26 / (outside + wall), rel=0.1)
    assert NOW.rims == 0
    assert NOW.fixed() == pytest.approx(np.hypot(NOW.floor(), 0.034 * 0.2))
    alone = replace(cluster, rims=0.0)
    more = dialled("normal", cluster).predicted ** 2 - dialled("normal", alone).predicted ** 2
    scatter = 0.046 * np.sqrt(0.2**3 / 0.26)
    assert more == pytest.approx((0.135**2 * 0.26**2 + 4.0**2 * scatter**2) * cluster.rims)
    # And what is asked for holds them.
    asked = 1.5 * cluster.fixed()
    assert dialled(f"{asked}um", cluster).predicted <= 1.02 * asked


def test_names_go_from_coarse_to_fine():
    quick, normal, careful = (dialled(name, NOW) for name in ("quick", "normal", "careful"))
    assert quick.edge > normal.edge == NOW.edge > careful.edge
    assert quick.accuracy == normal.accuracy == accuracy_for(0.046) > careful.accuracy
    clean = replace(NOW, noise=0.003)
    assert dialled("quick", clean).accuracy > dialled("normal", clean).accuracy
    assert quick.tolerance > normal.tolerance == FitSettings().tolerance > careful.tolerance
    assert (quick.trials, normal.trials, careful.trials) == (False, True, True)
    assert quick.predicted > normal.predicted > careful.predicted > NOW.fixed()
    assert careful.predicted < 1.1 * NOW.fixed()


@pytest.mark.parametrize("length", ["10.5nm", "0.011um", "14nm", "0.02um", "30 nm"])
def test_a_length_is_what_is_predicted(length):
    asked = FitSettings(shape_error=length).shape_error
    found = dialled(asked, NOW)
    number = float(asked[:-2]) * (1.0 if asked.endswith("um") else 1e-3)
    # Edges, accuracy and tolerance have bounds, and are no coarser than these.
    coarsest = found.edge == pytest.approx(0.35 * NOW.radius)
    assert coarsest == (number > 0.012)
    assert found.predicted <= 1.02 * number
    assert coarsest or found.predicted > 0.95 * number


def test_less_than_the_noise_allows_is_as_good_as_can_be():
    for now in (NOW, replace(NOW, rims=0.3)):
        found = dialled("1nm", now)
        assert now.fixed() < found.predicted <= dialled("careful", now).predicted


@pytest.mark.parametrize("wrong", ["best", "20", "-3nm", "nm", "infnm", "nannm"])
def test_what_is_no_choice_is_refused_in_a_sentence(wrong):
    with pytest.raises(ValueError, match="a length such as 20nm"):
        FitSettings(shape_error=wrong)


def test_a_run_takes_edges_accuracy_tolerance_and_trials_from_it():
    image = nd.render(BALL, GRID, nd.GaussianPSF(0.26)).numpy()
    image = np.random.default_rng(0).poisson(4 + 40 * image / image.max()).astype(np.float32)
    scene = SceneSettings(voxel_size=SIZE, sigma=(0.26,) * 3)

    def job(**fit):
        run = RunSettings(image="", seeds="", scene=scene, fit=FitSettings(**fit))
        return assemble(run, image, GRID, BALL, "labels")

    normal, careful, quick = job(), job(shape_error="careful"), job(shape_error="quick")
    assert normal.mesh is BALL
    assert careful.mesh.median_edge() < 0.9 * BALL.median_edge()
    assert careful.settings.fit.accuracy < normal.settings.fit.accuracy
    assert careful.settings.fit.tolerance < normal.settings.fit.tolerance
    assert quick.predicted > normal.predicted > careful.predicted
    each = (quick, normal, careful)
    assert [one.settings.fit.trials for one in each] == [False, True, True]
    assert not job(trials=False).settings.fit.trials
    given = job(shape_error="careful", accuracy=0.05, tolerance=0.03).settings.fit
    assert (given.accuracy, given.tolerance) == (0.05, 0.03)


def test_edges_that_are_about_right_stay():
    assert with_edges(BALL, 1.05 * BALL.median_edge()) is BALL
    assert len(with_edges(BALL, 0.3).vertices) > 2 * len(BALL.vertices)


def test_a_start_that_is_a_point_stays_what_it_is():
    point = nd.Mesh(np.ones((3, 3)), [[0, 1, 2]])
    for choice in ("quick", "20nm"):
        wanted = dialled(choice, Situation.of(point, GRID, (0.26,) * 3, 0.046))
        assert with_edges(point, wanted.edge) is point
    assert not Remeshing(point, 0.26).able
