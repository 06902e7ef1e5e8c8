"""Nuclei with chromatin are told from even ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_deltamic import FitState, GaussianPSF, Grid
from napari_deltamic.evidence.uneven_insides import inside_shares, uneven_insides
from napari_deltamic.evidence.verdict_rules import RULES
from napari_deltamic.fitting.job import FitInput
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import RunSettings, SceneSettings
from napari_deltamic.scene.light import INSIDES, MEMBRANES, Light
from napari_deltamic.scene.render import expected_image

GRID, OPTICS = Grid((30, 30, 30), (0.2,) * 3), GaussianPSF((0.26,) * 3)
NUCLEUS = sphere((2.9, 2.9, 2.9), 1.8, edge_length=0.35)
BACKGROUND = 10.0


def case(grain, light=INSIDES):
    """A job, its state, and the image of that: insides whose log brightness has this deviation."""
    shown = expected_image(NUCLEUS, GRID, OPTICS, 1e-3, 1.0, 0.0, light=light).clip(0)
    amplitude = 100.0 / float(shown.max())
    clumps = gaussian_filter(np.random.default_rng(0).normal(size=GRID.shape), 2.0)
    bright = amplitude * shown * np.exp(grain * clumps / clumps.std())
    image = np.random.default_rng(1).poisson(BACKGROUND + bright).astype(np.float32)
    scene = SceneSettings(voxel_size=GRID.voxel_size, sigma=OPTICS.sigma_um)
    run = RunSettings(image="", seeds="", scene=scene)
    density = np.ones(len(NUCLEUS.faces))
    state = FitState(
        1, 1, 1, NUCLEUS, OPTICS, density, 0.0, amplitude, BACKGROUND, 1.0, light=light
    )
    job = FitInput(run, image, GRID, NUCLEUS, OPTICS, None)
    return job, state, amplitude * shown + BACKGROUND


def test_an_even_one_has_no_unevenness():
    assert uneven_insides(*case(0.0)) == {}


@pytest.mark.parametrize("grain", [0.2, 0.4])
def test_chromatin_is_told(grain):
    found = uneven_insides(*case(grain))
    assert found[1] > RULES.uneven
    assert 0.4 * grain < found[1] < grain  # some is finer than what is read


def test_missing_voxels_are_passed_over():
    job, state, rendered = case(0.4)
    whole = uneven_insides(job, state, rendered)
    holes = np.random.default_rng(2).random(GRID.shape) < 0.1
    spoilt = replace(job, image=np.where(holes, np.nan, job.image))
    assert uneven_insides(spoilt, state, rendered)[1] == pytest.approx(whole[1], rel=0.1)


def test_membranes_have_no_inside_to_judge():
    assert uneven_insides(*case(0.4, MEMBRANES)) == {}


@pytest.mark.parametrize(
    ("light", "share"),
    [
        (INSIDES, 1.0),
        (MEMBRANES, 0.0),
        (Light(1.0, 0.5), 0.25),
        (Light(1.0, -0.5), 0.25),  # the medium is the brighter one
        (Light(1.0, 0.25, ((1, 2.0),)), 0.25),
    ],
)
def test_the_share_of_an_inside_is_read_off_its_image(light, share):
    """Where a membrane shines as well, it is brightest at the surface, by definition."""
    _, state, _ = case(0.0)
    found = inside_shares(replace(state, light=light))
    peak = 1 / (np.sqrt(2 * np.pi) * 0.26)  # of a flat membrane, for 1 per um^2
    inside = abs(light.interior) * float(light.of_cells([1])[0])
    assert found == {1: pytest.approx(inside / (inside + peak * light.membrane))}
    assert found[1] == pytest.approx(share, abs=0.01)
