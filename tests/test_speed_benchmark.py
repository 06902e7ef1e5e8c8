"""The benchmark of two builds runs through, with this build on both sides."""

import json
import math
import sys

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.geometry.remeshing import can_remesh

speed = pytest.importorskip("benchmarks.speed.__main__")
lines = pytest.importorskip("benchmarks.speed.lines")

from benchmarks.contacts import contact_errors  # noqa: E402
from benchmarks.speed import child  # noqa: E402
from benchmarks.speed.growing import error  # noqa: E402
from benchmarks.speed.jobs import Bench, Job, fit_job  # noqa: E402

from napari_deltamic.geometry.contacts import contact_areas  # noqa: E402

GRID, SIGMA = nd.Grid((20, 21, 22), (1.0, 1.0, 1.0)), 1.3
TRUTH = sphere((9.5, 10, 10.5), 6.0, subdivisions=2)


def tiny(bench):
    image = nd.render(TRUTH, GRID, nd.GaussianPSF(SIGMA), 1e-3).numpy()
    start = sphere((9.5, 10, 10.5), 5.0, subdivisions=2)
    given = image, GRID.voxel_size, SIGMA, start
    pair = bench.both(fit_job("tiny", *given, near=True, settings={"max_iterations": 10}))
    return [
        lines.compared("error", "voxel", pair, error(pair, TRUTH), lines.not_above()),
        lines.compared("evaluations", "", pair, "evaluations", lines.at_most(2)),
    ]


@pytest.mark.slow
def test_a_case_is_measured_on_both_sides_and_kept(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(speed.CASES, "tiny", tiny)
    results, page = tmp_path / "speed.json", tmp_path / "speed.md"
    page.write_text("<!-- speed:begin -->\n<!-- speed:end -->\n")
    results.write_text(json.dumps({"robustness": {"lines": [], "seconds": 0, **RUN}}))
    words = ["--only", "tiny", "--seed", "1", "--threads", "1", "--json", str(results)]
    assert speed.main([*words, "--baseline", sys.executable, "--page", str(page)]) == 1
    kept = json.loads(results.read_text())
    assert set(kept) == {"robustness", "tiny"}  # what was measured before stays
    first, second = kept["tiny"]["lines"]
    assert first["baseline"] == first["present"] < 0.9  # of 1 at the start
    assert first["passed"]
    assert not second["passed"]
    assert "| error, voxel | not above |" in capsys.readouterr().out
    assert "tiny" in page.read_text()


RUN = {"commit": "abc", "seed": 1, "quick": True, "threads": 2, "date": ""}


def test_a_push_goes_outward_within_its_brush():
    pushed = child._pushed(TRUTH, [[9.5, 10, 16.5]], 1.0, 4.0).vertices_numpy()
    before, middle = TRUTH.vertices_numpy(), np.array([9.5, 10, 10.5])
    touched = np.linalg.norm(before - [9.5, 10, 16.5], axis=1).argmin()
    assert np.linalg.norm(pushed[touched] - middle) == pytest.approx(7, abs=0.01)
    beyond = np.linalg.norm(before - before[touched], axis=1) >= 4
    np.testing.assert_array_equal(pushed[beyond], before[beyond])


def test_a_task_that_fails_is_told_and_does_not_pass(tmp_path):
    bench = Bench(folder=tmp_path, threads=1)
    values = {"voxel_size": [1, 1, 1], "sigma": [1, 1, 1], "near": False}
    pair = bench.both(Job("broken", "fit", {"image": np.zeros((9, 9, 9))}, values))
    told = lines.compared("error", "voxel", pair, lambda side: 0.0, lines.at_most(1))
    assert math.isnan(told.present)
    assert told.passed is False
    assert "KeyError" in told.note


def test_bars_without_a_baseline_are_open():
    assert lines.line("time", "s", None, 2.0, lines.faster(4)).passed is None
    assert lines.line("time", "s", 9.0, 2.0, lines.faster(4)).passed is True
    assert lines.line("time", "s", 7.0, 2.0, lines.faster(4)).passed is False
    assert lines.line("error", "", 7.0, math.nan, lines.not_above()).passed is False


@pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
def test_contacts_that_are_lost_or_made_up():
    centers = np.array([[0.0, 0, -6], [0, 0, 6], [0, 0, 18]])
    touching = foam(centers, np.full(3, 8.0), 2.0)
    apart = foam(centers - [[0, 0, 6], [0, 0, 0], [0, 0, 0]], np.full(3, 8.0), 2.0)
    found = contact_errors(contact_areas(apart), contact_areas(touching), 10.0)
    assert (found.right, found.lost, found.made_up) == (1, 1, 0)
    assert found.f1 == pytest.approx(2 / 3)
    assert contact_errors(contact_areas(touching), contact_areas(apart), 10.0).made_up == 1
