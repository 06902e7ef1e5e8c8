"""The mesh of a fit on its device, and states that have it from there."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.inference.state import FitState
from napari_deltamic.inference.surface import Surface

BALL = sphere((0, 0, 0), 1, subdivisions=0)
READY = dict(iteration=3, level=1, levels=2, optics=nd.GaussianPSF(0.2), blur=1.0)


def test_a_step_makes_another_surface():
    surface = Surface(BALL)
    before = surface.on(torch.device("cpu"))
    after = surface.moved(before + 1)
    np.testing.assert_array_equal(surface.mesh.vertices, BALL.vertices)
    np.testing.assert_array_equal(after.mesh.vertices, BALL.vertices + 1)
    assert after.mesh is after.mesh
    assert after.mesh.faces is BALL.faces


def test_the_vertices_of_the_caller_are_left_alone():
    vertices = Surface(BALL).on(torch.device("cpu"))
    vertices += 1
    assert not np.array_equal(BALL.vertices, vertices.numpy())


@pytest.fixture
def asked():
    return []


@pytest.fixture
def state(asked):
    def values():
        asked.append(1)
        return dict(mesh=BALL, density=np.ones(4), loss=0.25, amplitude=2.0, background=1.0)

    return FitState.late(values, **READY)


def test_values_stay_where_they_are_until_one_is_asked_for(state, asked):
    assert state.iteration == 3
    assert state.saying("on the way").message == "on the way"
    assert (state.message, state.converged, state.events) == ("", False, ())
    assert not asked
    assert state.loss == 0.25
    assert state.mesh is BALL
    assert len(asked) == 1


def test_a_late_state_is_a_state(state):
    changed = replace(state, converged=True)
    assert (changed.loss, changed.amplitude, changed.converged) == (0.25, 2.0, True)
    assert "loss=0.25" in repr(state)
    with pytest.raises(AttributeError, match="cannot assign"):
        state.loss = 1.0


def test_what_no_state_has_is_an_error(state, asked):
    with pytest.raises(AttributeError, match="no 'lost'"):
        _ = state.lost
    assert not asked
    assert not hasattr(FitState(1, 1, 1, BALL, None, None, 0.1, 1.0, 2.0, 1.0), "other")


def test_threads_may_ask_at_a_time(state, asked):
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda name: getattr(state, name), ["loss", "mesh"] * 20))
    assert found == [0.25, BALL] * 20
    assert 1 <= len(asked) <= 8
