"""Cytoplasm around a dark nucleus is told from a membrane by how thick it is."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.fitting import model_choice
from napari_deltamic.fitting.model.dimmed import with_nuclei
from napari_deltamic.fitting.rivals import dark_nuclei
from napari_deltamic.fitting.rivals.dark_nuclei import (
    RULES,
    _followed,
    _with_nuclei,
    around_nuclei,
)
from napari_deltamic.geometry import sphere
from napari_deltamic.measure.surface_distance import distance_to_surface
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.effects import Background, Effects
from napari_deltamic.scene.light import Light
from napari_deltamic.scene.render import offset

GRID = nd.Grid((32, 32, 32), (0.2, 0.2, 0.2))
MIDDLE = np.full(3, 3.1)
OPTICS = nd.GaussianPSF((0.26, 0.26, 0.26))
BALL = sphere(MIDDLE, 2.2, edge_length=0.4)


def radius(volume: float) -> float:
    return float(np.cbrt(3 / (4 * np.pi) * volume))


def test_a_cell_gets_a_nucleus_and_a_border_further_out():
    cells = _with_nuclei(BALL, GRID, 0.4)
    assert cells is not None
    assert cells.nuclei == {1: 2}
    held = cells.mesh.volumes()
    outer, inner = radius(held[1] + held[2]), radius(held[2])
    assert outer == pytest.approx(2.6, abs=0.2)
    assert inner == pytest.approx(1.8, abs=0.2)
    assert cells.thickness(cells.mesh) == pytest.approx(outer - inner, rel=0.05)
    assert cells.share(cells.mesh) == pytest.approx((inner / outer) ** 3)


def test_without_its_nucleus_a_cell_is_whole():
    cells = _with_nuclei(BALL, GRID, 0.4)
    outer = cells.outer(cells.mesh)
    assert outer.region_ids().tolist() == [1]
    assert outer.is_closed()
    held = cells.mesh.volumes()
    assert outer.volumes()[1] == pytest.approx(held[1] + held[2], rel=1e-6)


def test_cells_that_share_walls_keep_them():
    two = nd.geometry.mesh_from_labels(
        np.repeat([1, 2], 16)[:, None, None] * np.pad(np.ones((30, 30, 30), int), 1)[:32],
        (0.2,) * 3,
    )
    cells = _with_nuclei(two, GRID, 0.4)
    assert set(cells.nuclei) == {1, 2}
    outer = cells.outer(cells.mesh)
    assert sorted(outer.region_ids()) == [1, 2]
    assert (outer.regions > 0).all(axis=1).any()


def test_small_cells_have_none():
    assert _with_nuclei(sphere(MIDDLE, 0.6, edge_length=0.2), GRID, 0.4) is None


def test_the_light_of_cells_alone_and_of_even_ones():
    cells = _with_nuclei(BALL, GRID, 0.4)
    light = Light(0.0, 1.0, ((1, 1.2), (2, 0.3)))
    assert dict(cells.filled(light).cells) == {1: 1.2, 2: 1.2}
    assert cells.brightness(light) == pytest.approx(0.25)
    assert cells.without_nuclei(light).cells == ()  # one cell is its own scale
    with_another = replace(light, cells=((1, 1.2), (2, 0.3), (7, 0.9)))
    assert cells.without_nuclei(with_another).cells == ((1, 1.2), (7, 0.9))


SCATTER = 5.5 * (-1.0) ** np.arange(64)  # of nats by block


@pytest.mark.parametrize(
    ("thick", "gains", "is_layer", "legs"),
    [
        ([3.0, 3.0], [0.0, 0.0], True, 1),
        ([3.0, 2.9, 2.9], [-3.0, 2.0, 2.0], True, 2),  # it explained less at first, and gains
        ([1.9, 2.5, 2.5], [-3.0, 0.5, 0.5], True, 2),  # its PSF had widened before it moved
        ([1.9, 1.8], [0.0, 0.0], False, 1),
        ([3.0, 1.9], [1.0, 1.0], False, 1),  # around a membrane, borders come together
        ([3.6, 3.2, 2.7, 1.9], [9.0, 9.0, 9.0, 9.0], False, 3),  # however much it explains
        ([3.0, 3.0], [-40.0, -40.0], False, 0),
        ([3.4 * 0.94**k for k in range(20)], [float(k * k) for k in range(20)], False, 9),
    ],
)
def test_a_layer_stays_as_thick_as_it_is(monkeypatch, thick, gains, is_layer, legs):
    """After how many legs that is known, and whether it is a layer."""

    def rival(leg):
        fitted = SimpleNamespace(mesh=None, optics=OPTICS)
        return SimpleNamespace(leg=leg, fitted=fitted, now=SimpleNamespace(light=None))

    fitted = SimpleNamespace(shape=SimpleNamespace(model="smooth"), first_optics=OPTICS)
    for name in ("retriangulated", "shining", "displaced", "with_structure"):
        setattr(fitted, name, lambda *_: fitted)
    cells = SimpleNamespace(mesh=BALL, share=lambda _: 0.2, brightness=lambda _: 0.3)
    monkeypatch.setattr(dark_nuclei, "begun", lambda *_: rival(-1))
    monkeypatch.setattr(dark_nuclei, "descend_and_pose_anew", lambda one: (rival(one.leg + 1), 1))
    monkeypatch.setattr(dark_nuclei, "_thickness", lambda one, _: thick[one.leg])
    monkeypatch.setattr(dark_nuclei, "gains_over", lambda one, _: 2 * [gains[one.leg] + SCATTER])
    found, layer, taken = _followed(None, SimpleNamespace(fitted=fitted), cells)
    assert (layer, found.leg, taken) == (is_layer, legs, legs + 1)
    cells.share = lambda _: 0.45  # nothing is left of a cell but its nucleus
    assert not _followed(None, SimpleNamespace(fitted=fitted), cells)[1]
    cells.share, cells.brightness = lambda _: 0.2, lambda _: 0.6  # hardly dark
    assert not _followed(None, SimpleNamespace(fitted=fitted), cells)[1]


@pytest.mark.parametrize(
    "given",
    [
        {"second": object()},
        {"density": "uniform"},
        {"interior": -0.1},
        {"pinned": True},
        {"optics": nd.ScalarPSF(1.2, 0.6, 1.33)},
    ],
)
def test_nuclei_are_not_asked_for(given):
    settings = SimpleNamespace(density=given.get("density", "smooth"))
    terms = SimpleNamespace(second=given.get("second"), settings=settings)
    light = SimpleNamespace(interior=given.get("interior", 0.5))
    shape = SimpleNamespace(pinned=np.array([given.get("pinned", False)]))
    optics = given.get("optics", OPTICS)
    objective = SimpleNamespace(
        fitted=SimpleNamespace(shape=shape, optics=optics), now=SimpleNamespace(light=light)
    )
    assert around_nuclei(terms, objective) == (None, False, 0)


@pytest.mark.parametrize(("gained", "taken"), [(30.0, False), (300.0, True)])
def test_a_second_surface_pays_for_its_patches(monkeypatch, gained, taken):
    """A nucleus 1.8 um in radius has 150 patches twice as wide as the PSF."""
    cells = _with_nuclei(BALL, GRID, 0.4)
    assert cells.patches(cells.mesh, 0.26) == pytest.approx(150, rel=0.15)
    fitted = SimpleNamespace(
        mesh=BALL,
        optics=OPTICS,
        first_optics=OPTICS,
        shape=SimpleNamespace(pinned=np.zeros(1, bool)),
    )
    both = SimpleNamespace(
        fitted=fitted, now=SimpleNamespace(light=Light(1.0, 0.3)), evaluations=lambda: 1
    )
    both.anew = lambda: both
    rival = SimpleNamespace(fitted=SimpleNamespace(mesh=cells.mesh, optics=OPTICS))
    settings = SimpleNamespace(density="smooth", fit_psf=True)
    terms = SimpleNamespace(second=None, settings=settings, level=SimpleNamespace(grid=GRID))
    monkeypatch.setattr(dark_nuclei, "_with_nuclei", lambda *_: cells)
    monkeypatch.setattr(dark_nuclei, "_followed", lambda *_: (rival, True, 5))
    monkeypatch.setattr(dark_nuclei, "gains_over", lambda *_: 2 * [np.full((1, 64), gained / 64)])
    monkeypatch.setattr(dark_nuclei, "_alone", lambda *_: "around nuclei")
    expected = ("around nuclei", False, 6) if taken else (None, True, 6)
    assert around_nuclei(terms, both) == expected


# ---- whole fits ------------------------------------------------------------------------------


@cache
def image_of(membrane: bool, width: float = 0.26) -> np.ndarray:
    """Poisson noise on cytoplasm around a nucleus, or on a membrane around a dim inside.

    width : um, of the PSF.
    """
    given = GRID, nd.GaussianPSF((width,) * 3), 1e-3, 1.0, 0.0
    cell = sphere(MIDDLE, 2.2, edge_length=0.25)
    even = nd.scene.expected_image(cell, *given, light=Light(0.0, 1.0))
    if membrane:
        rim = nd.scene.expected_image(cell, *given, light=Light(1.0, 0.0))
        clean = rim / rim.max() + 0.3 * even / even.max()
    else:
        inner = sphere(MIDDLE + np.array([0.15, 0.1, -0.1]), 1.2, edge_length=0.2)
        clean = even - 0.75 * nd.scene.expected_image(inner, *given, light=Light(0.0, 1.0))
    photons = 100 * np.maximum(clean, 0) / clean.max() + 4
    return np.random.default_rng(0).poisson(photons).astype(np.float32)


def fitted(image: np.ndarray, width: float, fit_psf: bool = True, **further) -> nd.FitState:
    """The end of a fit."""
    begin = sphere(MIDDLE, 2.0, edge_length=0.5)
    settings = FitSettings(structure="auto", levels=(1.0,), fit_psf=fit_psf)
    given = image, GRID, begin, nd.GaussianPSF((width,) * 3)
    *_, last = nd.fit(*given, settings=settings, **further)
    return last


@cache
def end_of(membrane: bool, width: float = 0.26) -> nd.FitState:
    return fitted(image_of(membrane, width), width)


def off(state: nd.FitState) -> float:
    """Voxels."""
    true = sphere(MIDDLE, 2.2, edge_length=0.25)
    away = distance_to_surface(true.vertices_numpy(), state.mesh)
    return float(np.sqrt(np.mean(np.asarray(away) ** 2))) / 0.2


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.2, 0.22, 0.24, 0.26, 0.3])
def test_the_border_of_cytoplasm_is_found(width):
    """Both end in the middle of the layer, 1.4 to 1.9 voxels off."""
    last = end_of(False, width)
    assert last.converged
    assert last.dimmed is not None
    assert last.light.membrane == 0
    assert off(last) < 0.2


@pytest.mark.slow
def test_its_nucleus_is_in_the_rendered_image():
    rendered, measured = end_of(False).rendered(), image_of(False)
    core = (slice(14, 18),) * 3
    assert measured[core].mean() < 0.5 * np.percentile(measured, 99)
    assert rendered[core].mean() == pytest.approx(measured[core].mean(), rel=0.1)


def test_what_effects_add_is_not_dimmed():
    even, dimmed = np.full(GRID.shape, 30, np.float32), np.full(GRID.shape, 0.5, np.float32)
    none = with_nuclei(even, dimmed, 10.0, Effects(), GRID)
    np.testing.assert_allclose(none, 20)
    tilted = Effects.of(Background(coefficients=(0.0, 0.0, 5.0)))
    added = offset(tilted, GRID).numpy()
    assert np.ptp(added) > 0.1
    found = with_nuclei(even + added.astype(np.float32), dimmed, 10.0, tilted, GRID)
    np.testing.assert_allclose(found, 20 + added, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.2, 0.26, 0.32])
def test_a_membrane_around_a_dim_inside_stays_one(width):
    last = fitted(image_of(True, width), 0.26)
    assert last.dimmed is None
    assert last.light.membrane > 0
    assert off(last) < 0.15


@pytest.mark.slow
def test_a_layer_that_stands_in_for_a_wider_psf_is_none():
    """A PSF that is held and too narrow; taken, the surface would end 1.7 voxels off."""
    last = fitted(image_of(True, 0.36), 0.26, fit_psf=False)
    assert last.dimmed is None
    assert off(last) < 0.6


@pytest.mark.slow
def test_a_fit_goes_on_with_its_nuclei_from_a_checkpoint(tmp_path):
    end_of(False).save(tmp_path / "kept.npz")
    last = fitted(image_of(False), 0.26, resume=tmp_path / "kept.npz")
    np.testing.assert_array_equal(last.dimmed, end_of(False).dimmed)
    assert off(last) < 0.2
    kept = dict(np.load(tmp_path / "kept.npz"))
    for wrong in (kept["dimmed"][1:], 0 * kept["dimmed"]):
        np.savez(tmp_path / "damaged.npz", **{**kept, "dimmed": wrong})
        with pytest.raises(InputError, match="nuclei are of another image"):
            fitted(image_of(False), 0.26, resume=tmp_path / "damaged.npz")


@pytest.mark.slow
def test_what_may_be_cytoplasm_is_told(monkeypatch):
    """Also where insides alone, further out, explain less."""
    monkeypatch.setattr(model_choice, "around_nuclei", lambda *_: (None, True, 0))
    assert fitted(image_of(True), 0.26).unsure


def test_large_numbers_of_cells_have_nuclei():
    large = 2**31 + 5
    cells = _with_nuclei(
        nd.Mesh(BALL.vertices_numpy(), BALL.faces, BALL.regions * large), GRID, 0.4
    )
    assert cells.nuclei == {large: large + 1}
    assert set(cells.mesh.region_ids()) == {large, large + 1}


@pytest.mark.parametrize(("further", "seen"), [(0.05, True), (-0.05, False)])
def test_two_borders_are_seen_as_two_from_a_dip_between_them_on(further, seen):
    apart, x = RULES.apart + further, np.linspace(-4, 4, 8001)
    both = sum(np.exp(-((x - side * apart / 2) ** 2) / 2) for side in (-1, 1))
    assert (both.max() > both[4000] * (1 + 1e-9)) == seen


def test_borders_begin_as_far_apart_as_a_gaussian_is_wide():
    assert pytest.approx(2 * np.sqrt(2 * np.log(2)), abs=1e-3) == RULES.begin
