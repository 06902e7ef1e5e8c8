"""Every way to render a scene: errors that are true, and marks that are right."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.accuracy.tradeoff import PLANNED, Way, measure_ways, with_front
from napari_deltamic.common.words import duration
from napari_deltamic.fourier.cost import BUILT_IN, Rates
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import memory
from napari_deltamic.scene.memory import Peak

GRID = nd.Grid((18, 20, 19), (0.1, 0.1, 0.1), origin=(1.0, -2.0, 0.5))
OPTICS = nd.GaussianPSF(0.15)
MESH = sphere((1.85, -1.05, 1.4), (0.5, 0.6, 0.55), subdivisions=1)
IN_USE = 2e-3


@pytest.fixture(scope="module")
def ways():
    return list(measure_ways(MESH, GRID, OPTICS, IN_USE, costs=BUILT_IN))


def only(ways, **wanted):
    (found,) = [w for w in ways if all(getattr(w, k) == v for k, v in wanted.items())]
    return found


def test_those_of_the_planner_alone():
    """What the window shows; what it is compared with comes first."""
    found = list(measure_ways(MESH, GRID, OPTICS, IN_USE, costs=BUILT_IN, by_hand=False))
    assert [way.accuracy for way in found[1:]] == sorted({*PLANNED, IN_USE}, reverse=True)
    assert found[0].reference
    assert [way.accuracy for way in found if way.in_use] == [IN_USE]


def test_the_exact_way_is_the_reference(ways):
    first = ways[0]
    assert first.reference
    assert (first.method, first.band, first.precision) == ("closed form", 0, "float64")
    assert first.error == first.gradient_error == 0
    assert sum(w.reference for w in ways) == 1


def test_every_way_is_there(ways):
    for band in (0, 1e-1, 1e-2, 1e-3, 1e-4):
        for precision in ("float32", "float64"):
            only(ways, method="closed form", band=band, precision=precision, accuracy=None)
    for degree in (1, 2, 4, 6, 8):
        for precision in ("float32", "float64"):
            only(ways, rule=f"degree {degree}", precision=precision, accuracy=None)
    assert {w.accuracy for w in ways if w.accuracy} == {*PLANNED, IN_USE}
    assert {w.device for w in ways} == {"cpu"}
    assert all(w.measured for w in ways)


def test_errors_are_those_of_the_images(ways):
    exact = nd.render(MESH, GRID, OPTICS, 0)
    for accuracy in (1e-1, IN_USE, 1e-4):
        image = nd.render(MESH, GRID, OPTICS, accuracy)
        error = float((image - exact).norm() / exact.norm())
        assert only(ways, accuracy=accuracy).error == pytest.approx(error, rel=0.02)
        assert error < accuracy


def test_errors_fall_with_the_band_and_the_rule(ways):
    bands = [
        only(ways, method="closed form", band=b, precision="float64").error
        for b in (1e-1, 1e-2, 1e-3, 1e-4)
    ]
    assert bands == sorted(bands, reverse=True)
    assert bands[0] > 100 * bands[-1]
    rules = [only(ways, rule=f"degree {d}", precision="float64", accuracy=None) for d in (1, 2, 4)]
    for quantity in ("error", "gradient_error"):
        found = [getattr(w, quantity) for w in rules]
        assert found[0] > 3 * found[1] > 9 * found[2]
    single = only(ways, method="closed form", band=0, precision="float32").error
    assert 1e-8 < single < 1e-6


def test_times_and_memory(ways):
    for way in ways:
        assert 0 < way.forward < way.gradient
        assert way.expected > 0
    if memory.sys.platform.startswith("linux"):
        assert all(way.memory is not None and way.memory >= 0 for way in ways)
        assert max(way.memory for way in ways) < 2e9


def test_the_one_in_use_is_marked(ways):
    (used,) = [w for w in ways if w.in_use]
    assert used.accuracy == IN_USE
    (exact,) = [w for w in measure_ways(MESH, GRID, OPTICS, 0, costs=BUILT_IN) if w.in_use]
    assert exact.band == 0
    assert exact.precision == "float64"


def test_what_takes_too_long_is_listed_with_its_time():
    """With pairs a million times dearer, only the particle-meshs remain."""
    rates = {
        name: Rates(**{**vars(getattr(BUILT_IN, name)), "lines": 1e-2})
        for name in ("single_gradient", "double_gradient")
    }
    found = list(measure_ways(MESH, GRID, OPTICS, IN_USE, costs=replace(BUILT_IN, **rates)))
    first = found[0]
    assert first.reference
    assert first.method == "particle-mesh"
    assert first.accuracy < min(PLANNED)
    closed = [w for w in found if w.method == "closed form"]
    assert len([w for w in closed if w.accuracy is None]) == 10
    for way in closed:
        assert not way.measured
        assert way.note == f"not measured: about {duration(way.expected)}"
    rest = [w for w in found if w.method == "particle-mesh"]
    assert all(w.measured for w in rest)
    assert only(found, rule="degree 8", precision="float64", accuracy=None).error < 1e-4


def test_progress():
    seen = []

    def count(done, of):
        seen.append((done, of))

    found = measure_ways(MESH, GRID, OPTICS, costs=BUILT_IN, progress=count)
    next(found), next(found)
    assert [done for done, _ in seen] == [1, 2]
    assert seen[0][1] > 20


def test_failures_of_one_way_do_not_end_it(monkeypatch):
    """Too little memory for one way is told in its row."""
    whole = nd.fourier.Band.to_box

    def short_of_memory(band, values):
        if values.dtype == torch.complex64:
            raise RuntimeError("DefaultCPUAllocator: can't allocate memory: 8 GiB")
        return whole(band, values)

    monkeypatch.setattr(nd.fourier.Band, "to_box", short_of_memory)
    found = list(measure_ways(MESH, GRID, OPTICS, costs=BUILT_IN))
    failed = [w for w in found if w.note]
    assert {(w.method, w.precision, w.note) for w in failed} == {
        ("closed form", "float32", "not measured: not enough memory")
    }


@pytest.mark.parametrize("accuracy", [-1, 1, float("nan")])
def test_bad_accuracy(accuracy):
    with pytest.raises(nd.InputError, match="accuracy must be"):
        next(measure_ways(MESH, GRID, OPTICS, accuracy))


def test_a_mesh_that_is_not_in_the_image():
    mesh = MESH.translated((0.0, 6.0, 0.0))
    with pytest.raises(nd.InputError, match="empty"):
        list(measure_ways(mesh, GRID, OPTICS, costs=BUILT_IN))


# --------------------------------------------------------------------------------------- the front


def way(seconds, error, **more):
    return Way("closed form", 0.1, "", "float32", gradient=seconds, error=error, **more)


def test_front():
    ways = [
        way(1.0, 1e-1),
        way(2.0, 1e-2),
        way(2.5, 2e-2),  # slower and worse than the one before
        way(2.0, 3e-2),  # as fast and worse
        way(9.0, 1e-6),
        way(None, None, note="not measured"),
        way(0.1, 0.0, reference=True),
    ]
    assert [w.on_front for w in with_front(ways)] == [True, True, False, False, True, False, False]
    assert with_front([]) == []


def test_twins_are_both_on_the_front():
    assert all(w.on_front for w in with_front([way(1.0, 1e-3), way(1.0, 1e-3)]))


def test_names():
    assert way(1, 1).name == "closed form, |OTF| > 1e-01, float32"
    full = Way("particle-mesh", 0, "degree 2", "float64")
    assert full.name == "particle-mesh, full grid, degree 2, float64"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0123, "12 ms"),
        (1.26, "1.3 s"),
        (300, "5 min"),
        (7200 * 3, "6 h"),
        (86_400 * 12, "12 days"),
    ],
)
def test_durations(seconds, text):
    assert duration(seconds) == text


# ------------------------------------------------------------------------------------------ memory


@pytest.mark.skipif(not memory.sys.platform.startswith("linux"), reason="only Linux tells")
def test_peak_memory_counts_what_was_freed_again():
    with Peak() as peak:
        a = np.ones(12_000_000)
        del a
    assert 90e6 < peak.bytes < 130e6
    with Peak() as peak:
        pass
    assert peak.bytes < 5e6


def test_peak_memory_where_the_system_does_not_tell(monkeypatch):
    monkeypatch.setattr(memory.sys, "platform", "darwin")
    with Peak() as peak:
        pass
    assert peak.bytes is None
