"""The script that measures a GPU runs through without one, so that a lent GPU is not wasted."""

import re

import pytest

gpu = pytest.importorskip("benchmarks.gpu")


def rows_of(capsys, *figures):
    assert gpu.main(["--dry", "--only", *figures]) == 0
    return capsys.readouterr().out.split("a dry run on the CPU")[1]


def test_iterations(capsys):
    told = rows_of(capsys, "iterations")
    for figure in ("200^3, 500 faces, an image and its gradient", "500^3, 500 faces, an iteration"):
        assert figure in told


@pytest.mark.slow
def test_all_the_rest(capsys):
    told = rows_of(capsys, "first-use", "rates", "sphere-to-cow", "tests")
    assert re.search(r"GPU tests that fail +<= 0 +0 ", told)
    assert "closed form, small triangles, f32, forward" in told


def test_without_a_gpu_it_says_what_is_missing(capsys, monkeypatch):
    monkeypatch.setattr(gpu, "missing", lambda: "no NVIDIA GPU is found")
    assert gpu.main([]) == 2
    assert "nothing to measure: no NVIDIA GPU is found" in capsys.readouterr().err
