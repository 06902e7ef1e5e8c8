"""``napari-deltamic effects``, and effects that a fit takes by itself."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.cli.fit_command import _Run
from napari_deltamic.cli.messages import Notes
from napari_deltamic.geometry import sphere
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.scene import expected_image
from napari_deltamic.scene.effects import Effects, Halo

SIZE = (0.3, 0.2, 0.2)
SIGMA = ("--sigma", 0.42, 0.25, 0.25)
SHORT = ("--levels", 1, "--max-iterations", 60)
FEW = ("--candidates", "attenuation,halo")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A cell whose light is spread, and a mesh to start from."""
    folder = tmp_path_factory.mktemp("shining")
    grid = nd.Grid((22, 30, 30), SIZE)
    center = (3.15, 2.9, 2.9)
    truth = sphere(center, (1.7, 1.8, 1.8), edge_length=0.2)
    optics = nd.GaussianPSF(SIGMA[1:])
    plain = expected_image(truth, grid, optics, 1e-3, 1.0, 0.0)
    hazy = Effects.of(Halo(fraction=0.3, width=1.0))
    light = expected_image(truth, grid, optics, 1e-3, 60 / plain.max(), 4.0, effects=hazy)
    write_image(folder / "cell.tif", np.random.default_rng(0).poisson(light).astype("u2"), SIZE)
    nd.save_mesh(sphere(center, 1.7, edge_length=0.45), folder / "start.ply")
    return folder


def test_a_table_says_what_to_take_and_why(run, folder):
    code, lines, err = run(
        "effects", folder / "cell.tif", "--seeds", folder / "start.ply", *SIGMA, *SHORT, *FEW
    )
    assert code == 0, err
    assert lines[0].split()[:2] == ["effect", "score"]
    assert lines[1].startswith("halo")
    assert "take" in lines[1]
    assert "leaving it out would move the surface" in lines[1]
    gain = next(line for line in lines if line.startswith("gain: "))
    assert float(gain.split()[1]) == pytest.approx(1, rel=0.2)
    assert "--effects halo" in err


@pytest.mark.slow
def test_json_holds_all_of_it(run, folder):
    code, lines, err = run(
        *("effects", folder / "cell.tif", "--seeds", folder / "start.ply", *SIGMA, *SHORT),
        *(*FEW, "--json", "-"),
    )
    assert code == 0, err
    found = json.loads("\n".join(lines))
    assert found["recommended"] == ["halo"]
    assert {e["name"] for e in found["evidence"]} == {"attenuation", "halo"}
    assert found["effects"]["halo"]["fraction"] > 0.1
    assert {"gain", "read_noise", "offset", "saturation"} <= set(found["camera"])
    assert "sigma_z" in found["image"]


@pytest.mark.slow
def test_a_fit_takes_what_is_recommended_and_reports_it(run, folder, tmp_path):
    code, lines, err = run(
        *("fit", folder / "cell.tif", "--seeds", folder / "start.ply", *SIGMA, *SHORT),
        *("--effects", "auto", "--residual", "-o", tmp_path / "out"),
    )
    assert code == 0, err
    assert "effects: halo added: z = " in err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [e["name"] for e in report["effects"]] == ["halo"]
    assert report["recommendation"]["recommended"] == ["halo"]
    assert report["residual"]["cells"][0]["explained"] > 0.9
    assert "halo" in (tmp_path / "out" / "run.toml").read_text()
    assert read_image(tmp_path / "out" / "residual.tif")[0].shape == (22, 30, 30)
    assert str(tmp_path / "out" / "residual.tif") in lines


def test_a_file_that_cannot_be_written_is_refused_before_any_work(fails, folder, monkeypatch):
    monkeypatch.setattr("napari_deltamic.cli.effects_command.gather", None)
    given = ("effects", folder / "cell.tif", "--seeds", folder / "start.ply", "--json")
    said = fails(*given, folder / "none" / "a.json")
    assert f"{folder / 'none'} does not exist or cannot be written to" in said
    assert f"{folder} is a folder; name a file" in fails(*given, folder)


def test_bad_usage_is_one_line(fails, folder):
    given = ("effects", folder / "cell.tif", "--seeds", folder / "start.ply", *SIGMA)
    assert "leave out 'auto'" in fails(*given, "--effects", "auto")
    assert "choose from" in fails(*given, "--candidates", "ghosts")
    assert "--structure both" in fails(*given, "--effects", "bulk=0.2")


@pytest.mark.parametrize(
    ("explained", "kept"), [(0.95, "with"), (0.895, "with"), (0.8, "without"), (None, "without")]
)
def test_effects_with_which_a_fit_explains_less_are_left_out(
    tmp_path, monkeypatch, explained, kept
):
    shares = {"without": 0.9, "with": explained}
    notes = Notes()
    run = _Run(SimpleNamespace(name="without"), tmp_path, notes, auto=True)
    for part in ("image", "grid", "counted"):
        setattr(run.job, part, "")
    first = run.job
    run.last = before = SimpleNamespace(name="without")

    def follow(states):
        run.job = SimpleNamespace(image="", grid="", counted="")
        run.last = SimpleNamespace(name="with")

    monkeypatch.setattr(
        "napari_deltamic.cli.fit_command.analyse_residual",
        lambda image, grid, state, counted: SimpleNamespace(explained=shares[state.name]),
    )
    monkeypatch.setattr(run, "_with_recommended", lambda: iter(()))
    monkeypatch.setattr(run, "_follow", follow)
    run._follow_with_effects()
    assert (run.job is first) == (run.last is before) == (kept == "without")
    told = f"effects left out: the fit explains {explained or 0:.1%} with them, and 90.0% without"
    assert notes.texts == ([told] if kept == "without" else [])


def test_a_fit_that_calls_for_no_effects_is_not_judged_again(tmp_path, monkeypatch):
    run = _Run("the job", tmp_path, Notes(), auto=True)
    run.last = "the end"
    monkeypatch.setattr(run, "_with_recommended", lambda: iter(()))
    monkeypatch.setattr("napari_deltamic.cli.fit_command.analyse_residual", None)
    run._follow_with_effects()
    assert (run.job, run.last) == ("the job", "the end")
