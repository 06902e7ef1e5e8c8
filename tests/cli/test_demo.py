"""The demonstration without a display."""

import json

import pytest

from napari_deltamic.cli import demo_command, main
from napari_deltamic.runs.settings import RunSettings


@pytest.mark.usefixtures("judged")
def test_it_fits_writes_and_says_how_good(tmp_path, capsys):
    assert main(["demo", "--headless", "-o", str(tmp_path)]) == 0
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
    monkeypatch.setattr(demo_command.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not demo_command.has_display()
    monkeypatch.setenv("DISPLAY", ":0")
    assert demo_command.has_display()


@pytest.fixture
def shown(monkeypatch):
    """Which of the two ways a demonstration takes."""
    found = []
    monkeypatch.setattr(demo_command, "dividing_cell_sample", lambda: None)
    monkeypatch.setattr(demo_command, "has_display", lambda: True)
    monkeypatch.setattr(demo_command, "run_headless", lambda sample, folder: found.append(folder))
    return found


def test_without_napari_it_says_so_and_writes(shown, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(demo_command, "find_spec", lambda name: None)
    assert main(["demo", "-o", str(tmp_path)]) == 0
    assert shown == [tmp_path]
    assert "napari is not installed" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["report.json", "image.tif", "run.toml"])
def test_it_keeps_results_that_are_not_its_own(shown, monkeypatch, capsys, tmp_path, name):
    monkeypatch.chdir(tmp_path)
    for folder in ("mine", "demo-output"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).write_text("precious")
    assert main(["demo", "--headless", "-o", "mine"]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main(["demo", "--headless"]) == 0
    assert [folder.name for folder in shown] == ["demo-output"]
