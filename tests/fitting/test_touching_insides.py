"""Nuclei that touch: the wall between them does not show, and stays where they meet."""

import numpy as np
import pytest
from benchmarks.shapes import scaled

import napari_deltamic as nd
from napari_deltamic.fitting.objective import pose
from napari_deltamic.geometry import mesh_from_labels, sphere
from napari_deltamic.geometry.bending import BendingEnergy
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.light import INSIDES, MEMBRANES, structure_of

GRID = nd.Grid((20, 24, 40), (0.2, 0.2, 0.2))
OPTICS = nd.GaussianPSF((0.36, 0.24, 0.24))
PLACES = np.array([[1.9, 2.3, 1.9], [1.9, 2.4, 3.85], [1.9, 2.2, 5.75]])
RADII = np.array([0.95, 0.85, 0.9])


def balls(places: np.ndarray, radii: np.ndarray) -> nd.Mesh:
    parts = []
    for number, (place, radius) in enumerate(zip(places, radii, strict=True), 1):
        ball = sphere(place, radius, edge_length=0.25)
        parts.append(nd.Mesh(ball.vertices, ball.faces, ball.regions * number))
    return nd.Mesh.merge(parts)


def image_of(mesh: nd.Mesh, light: object, photons: float, dark: float) -> np.ndarray:
    shown = nd.scene.expected_image(mesh, GRID, OPTICS, 1e-4, 1.0, 0.0, light=light)
    counted = np.random.default_rng(0).poisson(photons * shown / shown.max() + dark)
    return counted.astype(np.float32)


def touching_labels() -> np.ndarray:
    """Of the three, a quarter of a micrometre too large: they share walls."""
    centres = np.moveaxis(np.indices(GRID.shape), 0, -1) * GRID.voxel_size
    outside = np.stack(
        [np.linalg.norm(centres - p, axis=-1) - r for p, r in zip(PLACES, RADII, strict=True)]
    )
    return np.where(outside.min(0) < 0.25, outside.argmin(0) + 1, 0)


@pytest.mark.parametrize("closed", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_the_wall_between_two_nuclei_stays_where_they_meet(closed, monkeypatch) -> None:
    """Free to end anywhere, as where membranes shine, it wanders through one of them."""
    if not closed:
        monkeypatch.setattr(pose, "CellBending", BendingEnergy)
    truth = balls(PLACES, RADII)
    image = image_of(truth, INSIDES, 60, 60)
    start = mesh_from_labels(touching_labels(), GRID.voxel_size)
    assert (start.regions > 0).all(1).sum() > 10
    settings = FitSettings(structure="interior", levels=(1.0,), topology=False)
    *_, last = nd.fit(image, GRID, start, OPTICS, settings=settings)
    off = [last.mesh.region_volume(k) / truth.region_volume(k) - 1 for k in (1, 2, 3)]
    assert (np.abs(off).max() < 0.15) == closed
    assert not any(np.isnan(off))


@pytest.mark.slow
@pytest.mark.parametrize(("light", "name"), [(INSIDES, "interior"), (MEMBRANES, "membrane")])
def test_what_shines_in_small_cells_is_asked_of_the_image(light, name) -> None:
    """Of 2.3 widths of the PSF: an inside, or a membrane further in, explains it as well."""
    places, radii = PLACES[[0, 2]], np.array([0.65, 0.62])
    truth = balls(places, radii)
    image = image_of(truth, light, 100, 20)
    start = balls(places + 0.05, 0.95 * radii)
    widths = [r / np.prod(OPTICS.sigma_um) ** (1 / 3) for r in radii]
    assert max(widths) < 2.5
    *_, last = nd.fit(image, GRID, start, OPTICS, settings=FitSettings(levels=(1.0,)))
    assert structure_of(last.light) == name
    for cell in (1, 2):
        assert abs(last.mesh.region_volume(cell) / truth.region_volume(cell) - 1) < 0.25


def test_a_level_without_voxels_is_not_asked_what_shines() -> None:
    """In small images the first level's blur is wider than the field of view."""
    grid, optics = nd.Grid((9, 9, 9), (0.2, 0.2, 0.2)), nd.GaussianPSF((0.3, 0.24, 0.24))
    truth = sphere(np.full(3, 0.8), 0.5, edge_length=0.2)
    shown = nd.scene.expected_image(truth, grid, optics, 1e-3, 1.0, 0.0)
    counted = np.random.default_rng(0).poisson(60 * shown / shown.max() + 5)
    start, settings = scaled(truth, 0.9), FitSettings(levels=(5.0, 1.0))
    *_, last = nd.fit(counted.astype(np.float32), grid, start, optics, settings=settings)
    assert structure_of(last.light) == "membrane"
    assert last.mesh.region_volume(1) == pytest.approx(truth.region_volume(1), rel=0.25)
