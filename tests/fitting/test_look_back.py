"""Whether insides alone may do as well is asked once, where a fit of both ends at rest."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting import level_run
from napari_deltamic.geometry import sphere
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene.light import INSIDES, Light

GRID = nd.Grid((24, 24, 24), (0.2, 0.2, 0.2))
OPTICS = nd.GaussianPSF((0.3, 0.24, 0.24))
MIDDLE = np.full(3, 2.3)
BOTH = Light(1.0, 1.5)


def start_of(light: Light) -> tuple[np.ndarray, nd.Mesh]:
    """A noisy image of a ball, and a smaller one beside its middle."""
    ball = sphere(MIDDLE, 1.35, edge_length=0.25)
    shown = nd.scene.expected_image(ball, GRID, OPTICS, 1e-4, 1.0, 0.0, light=light)
    shown = 60.0 * shown / np.ptp(shown) + 8.0
    image = np.random.default_rng(4).poisson(shown).astype(np.float32)
    return image, sphere(MIDDLE + np.array([0.1, -0.1, 0.15]), 1.2, edge_length=0.3)


@pytest.fixture
def asked(monkeypatch) -> list[object]:
    """Each time that it was asked; the answer is yes."""
    found: list[object] = []

    def may_do(terms, objective, factored):
        found.append(objective)
        return True, 7

    monkeypatch.setattr(level_run, "insides_may_do", may_do)
    return found


@pytest.mark.parametrize(
    ("light", "settings", "times"),
    [
        (BOTH, {}, 1),
        (BOTH, {"structure": "both"}, 0),  # a user has said it
        (BOTH, {"max_iterations": 3}, 0),  # never at rest
        (INSIDES, {}, 0),
    ],
    ids=["both", "told", "cut short", "insides alone"],
)
def test_it_is_asked_once_where_a_fit_of_both_ends(light, settings, times, asked):
    image, start = start_of(light)
    *_, last = nd.fit(image, GRID, start, OPTICS, settings=FitSettings(**settings))
    assert len(asked) == times
    assert last.unsure == bool(times)


def test_a_fit_that_was_changed_is_asked_again_at_its_end(asked):
    image, start = start_of(BOTH)
    states = nd.fit(image, GRID, start, OPTICS)
    for state in states:
        if state.iteration == 5:
            states.send(nd.fitting.Change(mesh=start))
        last = state
    assert len(asked) == 1
    assert last.unsure
