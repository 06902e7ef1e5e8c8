"""The PSF on the command line: from the objective, from a bead, from a file; never two."""

import json

import pytest

from napari_deltamic.cli import main

WATER = ["--na", "1.1", "--wavelength", "0.6", "--immersion", "water"]
SIZE = ["--voxel-size", "0.3", "0.2", "0.2"]


def rendering(data, tmp_path, *words):
    shape = ["--shape", "20", "24", "24"]
    return main(
        ["render", str(data / "start.ply"), *shape, *SIZE, *words, "-o", str(tmp_path / "a.tif")]
    )


def test_render_from_the_objective(data, tmp_path):
    assert rendering(data, tmp_path, *WATER, "--modality", "confocal") == 0
    assert (tmp_path / "a.tif").is_file()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((*WATER, "--sigma", "1", "1", "1"), "give one of them"),
        (("--na", "1.1"), "needs --wavelength too"),
        ((), "give the PSF"),
        (("--sigma", "1", "1", "1", "--bead-diameter", "0.1"), "belongs to --psf"),
        (("--na", "1.1", "--wavelength", "600"), "did you mean 0.6"),
        (("--na", "1.5", *WATER[2:]), "must be below the refractive index"),
        (("--psf", "none.tif"), "none.tif"),
    ],
)
def test_what_cannot_be_a_psf(data, tmp_path, capsys, words, reason):
    assert rendering(data, tmp_path, *words) == 2
    assert reason in capsys.readouterr().err


def test_fit_reports_the_parameters_and_runs_again_from_its_settings(data, tmp_path):
    words = [*WATER, "--psf-model", "scalar", "--fit-psf", "--levels", "1"]
    short = ["--max-iterations", "3", "-o", str(tmp_path / "out")]
    seeds = ["--seeds", str(data / "start.ply")]
    assert main(["fit", str(data / "cell.tif"), *seeds, *words, *short]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["optics"]["model"] == "ScalarPSF"
    assert len(report["optics"]["sigma_um"]) == 3
    assert report["optics"]["parameters"]["na"]["fitted"]
    toml = str(tmp_path / "out" / "run.toml")
    assert main(["fit", "--settings", toml, "-o", str(tmp_path / "again")]) == 0
    again = json.loads((tmp_path / "again" / "report.json").read_text())
    assert again["loss"] == report["loss"]
