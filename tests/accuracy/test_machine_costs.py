"""The cost model: what is counted, what is measured, and what is kept on disk."""

import json
import sys
from dataclasses import astuple, fields, replace

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.accuracy import machine_costs
from napari_deltamic.accuracy.calibration import calibrate
from napari_deltamic.accuracy.machine_costs import costs, costs_file, expected_seconds
from napari_deltamic.fourier import make_plan
from napari_deltamic.fourier.cost import BUILT_IN, Rates, Work
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene

OPTICS = nd.GaussianPSF(0.15)
MESH = sphere((1.5, 1.5, 1.5), 0.9, subdivisions=2)


def renderer(side=30, accuracy=1e-2, method=None, mesh=MESH):
    return Renderer(
        Scene.of(mesh, OPTICS), nd.Grid((side,) * 3, (0.1,) * 3), accuracy, method=method
    )


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache, and a process that has not looked for one yet."""
    monkeypatch.setenv("DELTAMIC_CACHE", str(tmp_path / "deep" / "cache"))
    monkeypatch.setattr(machine_costs, "_known", {})
    return tmp_path / "deep" / "cache"


@pytest.fixture
def measured(monkeypatch):
    """Counts measurements, and makes them instant: twice the built-in costs."""
    count = []

    def twice():
        count.append(1)
        return replace(BUILT_IN, vertex=2 * BUILT_IN.vertex, measured=True)

    monkeypatch.setattr("napari_deltamic.accuracy.machine_costs.calibrate", twice)
    return count


# ------------------------------------------------------------------------------------- counting


def test_pairs_are_those_of_the_band():
    plan = renderer(method="closed form").plan
    assert plan.work.small_pairs + plan.work.large_pairs == pytest.approx(
        plan.band.count * len(MESH.faces)
    )
    assert plan.work.lines == len(plan.band.rows) * len(MESH.faces)
    assert plan.work.points == plan.work.cells == 0


def test_small_triangles_take_the_small_branch():
    shares = []
    for subdivisions in (0, 2, 4):
        mesh = sphere((1.5, 1.5, 1.5), 0.9, subdivisions=subdivisions)
        work = renderer(method="closed form", mesh=mesh).plan.work
        shares.append(work.small_pairs / (work.small_pairs + work.large_pairs))
    assert 0 < shares[0] < 0.3 < shares[1] < 0.9 < shares[2] <= 1


def test_points_are_those_of_the_plan():
    plan = renderer(method="particle-mesh").plan
    assert plan.work.points == plan.points > 0
    assert plan.work.small_pairs == plan.work.large_pairs == 0
    finer = renderer(method="particle-mesh", accuracy=1e-4).plan
    assert finer.work.kernel / finer.points > plan.work.kernel / plan.points
    assert finer.work.cells > plan.work.cells


def test_pixels_grow_with_the_image():
    small, large = (renderer(side).plan.work.pixels for side in (30, 60))
    # Voxels and logarithm, though the band within them is the same.
    assert 4 < large / small < 10


def test_seconds_are_linear_in_the_work():
    rates = Rates(1.0, 2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0)
    assert rates.seconds(Work()) == 1
    for i, price in enumerate((2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0)):
        one = Work(*(float(i == k) for k in range(7)))
        assert rates.seconds(one) == 1 + price


# ------------------------------------------------------------------------------------ measuring


def test_calibration_measures_every_cost():
    found = calibrate()
    assert found.measured
    for f in fields(found):
        value = getattr(found, f.name)
        numbers = astuple(value) if isinstance(value, Rates) else (value,)
        assert all(np.isfinite(n) and n >= 0 for n in numbers), f.name
    # A gradient costs more than an image alone; four transforms, a transform.
    for single in (True, False):
        work = renderer(accuracy=1e-2 if single else 1e-6, method="particle-mesh").plan.work
        assert found.seconds(work, single, True) > 1.2 * found.seconds(work, single, False)


def test_expected_seconds_are_those_of_this_machine(folder, measured, monkeypatch):
    plan = renderer().plan
    before = expected_seconds(plan.work, plan.single)
    assert before == pytest.approx(BUILT_IN.seconds(plan.work, plan.single))
    dear = replace(
        BUILT_IN, single_gradient=Rates(*(10 * r for r in astuple(BUILT_IN.single_gradient)))
    )
    monkeypatch.setattr(
        machine_costs, "_known", {(str(costs_file()), torch.get_num_threads()): dear}
    )
    assert expected_seconds(plan.work, plan.single) == pytest.approx(10 * before)


def test_the_method_does_not_depend_on_the_machine(monkeypatch):
    """The same settings give the same image everywhere, whatever was measured there."""
    v, f = MESH.vertices_numpy(), MESH.faces
    arguments = v, f, (30,) * 3, (0.1,) * 3, (0.15,) * 3, 1e-2
    usual = make_plan(*arguments).method
    assert usual == "particle-mesh"
    free = replace(BUILT_IN, single_gradient=Rates(0, 0, 0, 0, 1, 1, 1, 0))
    known = {(str(costs_file()), torch.get_num_threads()): free}
    monkeypatch.setattr(machine_costs, "_known", known)
    assert costs() is free
    assert make_plan(*arguments).method == usual


# ---------------------------------------------------------------------------------- kept on disk


def test_nothing_is_measured_unless_asked(folder, measured):
    assert costs() is BUILT_IN
    assert not folder.exists()
    nd.render(MESH, nd.Grid((12,) * 3, (0.25,) * 3), OPTICS)
    assert measured == []


def test_costs_are_measured_once(folder, measured, monkeypatch):
    found = costs(measure=True)
    assert found.vertex == 2 * BUILT_IN.vertex
    assert costs() is found
    monkeypatch.setattr(machine_costs, "_known", {})  # another process
    assert costs() == found
    assert costs(measure=True) == found
    assert len(measured) == 1
    assert costs(again=True).measured
    assert len(measured) == 2
    kept = json.loads(costs_file().read_text())["of"]
    assert kept["threads"] == torch.get_num_threads()
    assert kept["version"] == nd.__version__
    assert kept["machine"]


def spoilt_of(name, value):
    def spoil(path):
        kept = json.loads(path.read_text())
        kept["of"][name] = value
        path.write_text(json.dumps(kept))

    return spoil


def negative(path):
    kept = json.loads(path.read_text())
    kept["costs"]["single_forward"]["points"] = -1
    path.write_text(json.dumps(kept))


SPOILT = {
    "another machine": spoilt_of("machine", "a calculator"),
    "another version": spoilt_of("version", "0.0.1"),
    "more threads": spoilt_of("threads", 99),
    "half a file": lambda path: path.write_text(path.read_text()[:300]),
    "no JSON": lambda path: path.write_bytes(b"\xff\x00"),
    "a list": lambda path: path.write_text("[1, 2]"),
    "a negative cost": negative,
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("how", SPOILT)
def test_what_is_stale_or_damaged_is_measured_again(folder, measured, monkeypatch, how):
    costs(measure=True)
    SPOILT[how](costs_file())
    monkeypatch.setattr(machine_costs, "_known", {})
    assert costs() is BUILT_IN
    assert costs(measure=True).measured
    assert len(measured) == 2


def test_a_file_in_the_way_of_the_folder(tmp_path, measured, monkeypatch):
    monkeypatch.setattr(machine_costs, "_known", {})
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DELTAMIC_CACHE", str(tmp_path / "file" / "below"))
    assert costs(measure=True).measured
    assert costs().measured


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have other folders")
def test_where_they_are_kept_by_default(monkeypatch, tmp_path):
    monkeypatch.delenv("DELTAMIC_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert costs_file().parent == tmp_path / "napari-deltamic"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert costs_file().parent == tmp_path / ".cache" / "napari-deltamic"
