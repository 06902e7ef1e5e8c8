"""Simulated images: reproducible, with the statistics and the truth that they claim."""

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Filament, Points, Scene, Solid, Surface, random_cells, simulate
from napari_deltamic.scene.effects import Effects

GRID = nd.Grid((20, 24, 26), (0.3, 0.2, 0.2))
OPTICS = nd.GaussianPSF((0.36, 0.24, 0.24))
CENTRE = (2.9, 2.3, 2.5)
BALL = sphere(CENTRE, (1.2, 1.1, 1.3), subdivisions=2)
SCENE = Scene(Surface(BALL), OPTICS)


def with_effects(text):
    return SCENE.with_effects(Effects.from_text(text))


def test_photons_are_those_of_the_brightest_voxel():
    made = simulate(SCENE, GRID, photons=80, background=7)
    assert made.noise_free.max() == pytest.approx(87, rel=1e-5)
    assert made.parameters["background"] == 7
    assert made.image.dtype == np.uint16


def test_photons_can_be_given_by_density():
    made = simulate(SCENE, GRID, photons_per_density=300, background=0)
    plain = nd.render(BALL, GRID, OPTICS, 1e-5).numpy()
    np.testing.assert_allclose(made.noise_free, 300 * plain, atol=1e-3)
    assert made.parameters["photons"] == pytest.approx(300 * plain.max(), rel=1e-4)


def test_insides_take_no_more_light_than_the_background_has():
    dark = Scene((Surface(BALL), Solid(BALL, -1.0)), OPTICS)
    with pytest.raises(nd.InputError, match="negative light: -"):
        simulate(dark, GRID, photons=80, background=10)
    made = simulate(dark, GRID, photons=80, background=200)
    assert 0 < made.noise_free.min() < 190


def test_noise_is_that_of_photons():
    images = [simulate(SCENE, GRID, photons=60, seed=s) for s in range(30)]
    mean = images[0].noise_free
    residual = np.array([i.image - mean for i in images]) / np.sqrt(mean)
    assert abs(residual.mean()) < 5 / np.sqrt(residual.size)
    assert residual.var() == pytest.approx(1, rel=0.02)


def test_the_same_seed_gives_the_same_bytes_with_any_number_of_threads():
    found, before = [], torch.get_num_threads()
    try:
        for threads in (1, 2, 1):
            torch.set_num_threads(threads)
            made = simulate(with_effects("camera:read_noise=2:offset=50"), GRID, seed=5)
            found.append((made.image.tobytes(), made.labels.tobytes()))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert found[0] == found[1] == found[2]
    assert simulate(SCENE, GRID, seed=6).image.tobytes() != found[0][0]


def test_labels_are_the_regions():
    made = simulate(Scene(Solid(BALL), OPTICS), GRID)
    voxel = np.prod(GRID.voxel_size)
    assert (made.labels == 1).sum() * voxel == pytest.approx(BALL.region_volume(1), rel=0.03)
    assert made.labels.dtype == np.int32
    assert made.mesh is BALL


def test_a_mesh_that_is_surface_and_solid_counts_once():
    other = sphere(CENTRE, 0.3, subdivisions=1)
    made = simulate(Scene((Surface(BALL), Solid(BALL), Solid(other)), OPTICS), GRID)
    assert made.mesh.region_ids().tolist() == [1, 2]


def test_without_meshes_there_are_no_labels():
    path = np.array([[0, 0, 0], [0.5, 0.3, 0.2]]) + CENTRE
    made = simulate(Scene((Points(path), Filament(path)), OPTICS), GRID)
    assert made.mesh is None
    assert made.labels is None


def test_the_camera_makes_intensities():
    made = simulate(
        with_effects("camera:gain=3:offset=200:read_noise=4"), GRID, photons=50, background=10
    )
    assert made.noise_free.max() == pytest.approx(200 + 3 * 60, rel=1e-5)
    assert made.noise_free.min() > 229
    full = simulate(with_effects("camera:saturation=40"), GRID, photons=50)
    assert full.image.max() == 40


def test_missing_voxels_have_their_value():
    made = simulate(with_effects("missing:slices=[0,3]:value=7"), GRID)
    assert (made.image[[0, 3]] == 7).all()
    assert (made.image[[1, 2, 4]] != 7).any()


def test_a_background_is_in_the_unit_of_the_image():
    name = "background"
    effects = Effects.of(name)
    effect = getattr(effects, name)
    parameters = effect.parameters() * 0 + 1
    added = effects.replace(**{name: effect.with_parameters(parameters)})
    plain, other = (simulate(SCENE.with_effects(e), GRID, bits=32) for e in (Effects(), added))
    shift = other.noise_free - plain.noise_free
    assert np.abs(shift).max() > 0


BAD = {
    "photons 0": ({"photons": 0}, "photons must be positive"),
    "photons nan": ({"photons": float("nan")}, "photons must be positive"),
    "density -1": ({"photons_per_density": -1}, "photons_per_density must be positive"),
    "both": ({"photons": 1, "photons_per_density": 1}, "not both"),
    "background": ({"background": -1}, "background must be"),
    "seed -1": ({"seed": -1}, "a seed is a whole number"),
    "seed 0.5": ({"seed": 0.5}, "a seed is a whole number"),
    "bits": ({"bits": 9}, "bits must be"),
    "too bright": ({"photons": 1e6}, "16 bits hold 65535"),
    "accuracy": ({"accuracy": 2}, "accuracy must be"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_numbers(name):
    options, says = BAD[name]
    with pytest.raises(nd.InputError, match=says):
        simulate(SCENE, GRID, **options)


def test_what_is_not_seen_is_no_image():
    with pytest.raises(nd.InputError, match="nothing of the scene is seen"):
        simulate(Scene(Surface(BALL, 0.0), OPTICS), GRID)
    with pytest.raises(nd.InputError, match="one view"):
        simulate(with_effects("second_view:sigma=[0.3,0.3,0.3]"), GRID)


# ----------------------------------------------------------------------------------- random cells


@pytest.mark.parametrize("kind", ["foam", "vesicles"])
@pytest.mark.parametrize("count", [1, 3, 6])
def test_random_cells_are_whole_and_inside(kind, count):
    grid = nd.Grid((32, 44, 44), (0.3, 0.2, 0.2))
    mesh = random_cells(count, grid, kind, seed=count)
    assert mesh.region_ids().tolist() == list(range(1, count + 1))
    assert mesh.is_closed()
    assert min(mesh.volumes().values()) > 20 * np.prod(grid.voxel_size)
    low, high = mesh.bounds()
    first, last = grid.extent
    assert (low > first + 0.3).all()
    assert (high < last - 0.3).all()
    # A foam has walls between cells, vesicles do not.
    assert (mesh.regions > 0).all(1).any() == (kind == "foam" and count > 1)


def test_random_cells_follow_the_seed():
    one, same, other = (random_cells(3, GRID, "vesicles", s).vertices for s in (1, 1, 2))
    assert np.array_equal(one, same)
    assert one.shape != other.shape or not np.array_equal(one, other)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((0,), "must be 1 or more"),
        ((500,), "no room for 500 cells"),
        ((2, "cubes"), "'foam' or 'vesicles'"),
        ((2, "foam", -3), "a seed is a whole number"),
    ],
)
def test_bad_random_cells(arguments, says):
    count, *rest = arguments
    with pytest.raises(nd.InputError, match=says):
        random_cells(count, GRID, *rest)
