"""``napari-deltamic fit --second-view``: a second image of the same scene."""

import json

import numpy as np
import pytest

from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.runs.settings import RunSettings

SIZE = (0.3, 0.2, 0.2)
SIGMA = ("--sigma", "0.36", "0.24", "0.24")
SHORT = ("--max-iterations", "4")

PSF = ("--second-sigma", "0.2", "0.2", "0.3")


@pytest.fixture
def given(data):
    return ("fit", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA, *SHORT)


@pytest.mark.usefixtures("judged")
def test_it_reaches_the_fit_and_run_toml_repeats_it(data, given, tmp_path, run):
    pixels = read_image(data / "cell.tif")[0]
    path = tmp_path / "second.tif"
    write_image(path, pixels[:, ::-1].astype(np.float32), SIZE)
    options = ("--second-view", path, *PSF)
    code, _, err = run(*given, *options, "--effects", "attenuation", "-o", tmp_path / "a")
    assert code == 0, err
    view = RunSettings.from_toml(tmp_path / "a" / "run.toml").scene.effects.second_view
    assert view is not None
    assert view.image == str(path)
    assert view.sigma == (0.2, 0.2, 0.3)
    run("fit", "--settings", tmp_path / "a" / "run.toml", "-o", tmp_path / "b")
    run(*given, "--effects", "attenuation", "-o", tmp_path / "c")
    losses = [json.loads((tmp_path / k / "report.json").read_text())["loss"] for k in "abc"]
    assert losses[0] == losses[1]
    assert losses[0] != losses[2]


def test_it_is_added_to_the_effects_of_a_settings_file(data, given, tmp_path, run, seen):
    run(*given, "--effects", "attenuation", "-o", tmp_path / "a")
    options = ("--second-view", data / "cell.tif", *PSF)
    run("fit", "--settings", tmp_path / "a" / "run.toml", *options, "-o", tmp_path / "b")
    assert seen[-1][1]["effects"].names == ("attenuation", "second_view")


@pytest.mark.parametrize("asked", ["none", "attenuation"])
def test_other_effects_leave_it(data, given, tmp_path, run, seen, asked):
    """It is data, which has flags of its own."""
    options = ("--second-view", data / "cell.tif", *PSF)
    run(*given, *options, "-o", tmp_path / "a")
    settings = ("--settings", tmp_path / "a" / "run.toml", "--effects", asked)
    code, _, err = run("fit", *settings, "-o", tmp_path / "b")
    assert code == 0, err
    effects = seen[-1][1]["effects"]
    assert effects.names == (("second_view",) if asked == "none" else (asked, "second_view"))
    assert effects.view.image == str(data / "cell.tif")


def test_bad_second_views_are_told(data, given, tmp_path, fails):
    out = ("-o", tmp_path / "out")
    assert "needs --second-sigma" in fails(*given, "--second-view", data / "cell.tif", *out)
    assert "belongs to --second-view" in fails(*given, *PSF, *out)
    assert "there is no file" in fails(*given, "--second-view", tmp_path / "no.tif", *PSF, *out)
    zero = ("--second-sigma", "0.2", "0", "0.3")
    assert "sigma" in fails(*given, "--second-view", data / "cell.tif", *zero, *out)
    small, other = tmp_path / "small.tif", tmp_path / "other.tif"
    write_image(small, np.random.default_rng(0).random((5, 6, 7), np.float32), SIZE)
    assert "second view: the image has shape" in fails(*given, "--second-view", small, *PSF, *out)
    write_image(other, read_image(data / "cell.tif")[0], (0.2, 0.2, 0.2))
    assert "resample it on the image's voxels" in fails(*given, "--second-view", other, *PSF, *out)
    assert not (tmp_path / "out").exists()
