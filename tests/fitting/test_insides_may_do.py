"""Cytoplasm around a dark nucleus, a few widths of the PSF thick, looks like a membrane."""

from types import SimpleNamespace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting import fit, level_run, model_choice
from napari_deltamic.fitting.model.shape import Shape
from napari_deltamic.fitting.rivals import rival_structures
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from synthetic import CENTER, GRID, OPTICS, RADIUS

FEW = np.array([20.0, 15.0, 10.0, 5.0, 3.0])  # nats, 1.9 errors
MANY = np.full(16, 10.0)  # 4 errors


def ended(*shining):
    scene = nd.Scene(shining, OPTICS)
    image = nd.simulate(scene, GRID, photons=60.0, background=5.0, seed=3).image
    settings = FitSettings(levels=(1.0,), fit_psf=True)
    *_, state = fit(image, GRID, sphere(CENTER, RADIUS, subdivisions=3), OPTICS, settings=settings)
    return state


def test_cytoplasm_whose_nucleus_is_not_found_is_doubted(monkeypatch):
    asked = []
    monkeypatch.setattr(model_choice, "around_nuclei", lambda *_: (None, False, 0))

    def counted(terms, objective, factored):
        asked.append(objective)
        return rival_structures.insides_may_do(terms, objective, factored)

    monkeypatch.setattr(level_run, "insides_may_do", counted)
    cell, nucleus = (sphere(CENTER, r * RADIUS, subdivisions=3) for r in (1.0, 0.5))
    state = ended(nd.Solid(cell), nd.Solid(nucleus, -0.75))
    # What makes the test worth its name: the fit is wrong.
    assert state.light.membrane > 0
    assert state.mesh.volumes()[1] < 0.8 * cell.volumes()[1]
    assert state.unsure
    assert len(asked) == 1  # in the end: a few steps of another fit take time


@pytest.mark.slow
def test_a_membrane_with_a_dim_inside_is_not():
    cell = sphere(CENTER, RADIUS, subdivisions=3)
    state = ended(nd.Surface(cell, 0.5), nd.Solid(cell))
    assert state.light.membrane > 0 < state.light.interior
    assert state.mesh.volumes()[1] == pytest.approx(cell.volumes()[1], rel=0.05)
    assert not state.unsure


@pytest.mark.parametrize(
    ("interior", "gains", "doubted", "further"),
    [
        (0.3, [FEW, FEW], True, 1.18),
        (0.3, [FEW, MANY], True, 1.18),  # with insides evened, they are near
        (0.3, [MANY, MANY], False, 1.18),
        (5.0, [FEW, FEW], True, 0.2 / 0.3989),  # too bright for a dark middle
        (-0.3, [FEW, FEW], False, None),  # darker than the medium
    ],
)
def test_insides_alone_may_do_unless_both_surely_explain_more(
    monkeypatch, interior, gains, doubted, further
):
    mesh, begun = sphere((0.0, 0.0, 0.0), 2.0, edge_length=0.4), []

    def displaced(vertices, optics):
        begun.append((vertices, optics))
        return SimpleNamespace(with_structure=lambda name: name)

    # The peak of the image of a membrane of 1, through a PSF of this width, is 1.
    width = 1 / np.sqrt(2 * np.pi)
    first = SimpleNamespace(sigma_um=(width,) * 3)
    fitted = SimpleNamespace(
        shape=Shape.begun(mesh, "uniform"),
        optics=SimpleNamespace(sigma_um=(width,) * 3),
        first_optics=first,
        displaced=displaced,
    )
    both = SimpleNamespace(
        fitted=fitted,
        now=SimpleNamespace(light=SimpleNamespace(membrane=1.0, interior=interior)),
        terms=SimpleNamespace(settings=SimpleNamespace(structure="auto", collisions=False)),
        evaluations=lambda: 1,
    )
    both.anew = lambda: both
    monkeypatch.setattr(rival_structures, "begun", lambda terms, one, factored: one)
    monkeypatch.setattr(rival_structures, "descend_and_pose_anew", lambda one: (one, 5))
    monkeypatch.setattr(rival_structures, "gains_over", lambda one, other: gains)
    found, taken = rival_structures.insides_may_do(both.terms, both, None)
    assert found is doubted
    assert taken == (0 if further is None else 6)
    assert len(begun) == (further is not None)
    for vertices, optics in begun:
        assert optics is first
        away = np.linalg.norm(vertices, axis=1) - 2
        np.testing.assert_allclose(away, further * width, atol=0.02)
