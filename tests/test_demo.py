"""The demonstration without a display."""

import json

import pytest

from napari_deltamic import demo
from napari_deltamic.settings import RunSettings


def test_it_fits_writes_and_says_how_good(tmp_path, capsys):
    assert demo.main(["--headless", "-o", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "converged" in out
    assert str(tmp_path) in out
    error = float(out.split("surface error: ")[1].split()[0])
    assert error < 0.2  # voxels
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["converged"]
    assert report["optics"]["sigma_um"] == pytest.approx([0.36, 0.2, 0.2], rel=0.05)
    settings = RunSettings.from_toml(tmp_path / "run.toml")
    for path in (settings.image, settings.seeds, tmp_path / "picture.png", tmp_path / "mesh.ply"):
        assert (tmp_path / path).is_file()


def test_it_opens_a_window_only_where_there_is_a_display(monkeypatch):
    monkeypatch.setattr(demo.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not demo.has_display()
    monkeypatch.setenv("DISPLAY", ":0")
    assert demo.has_display()
