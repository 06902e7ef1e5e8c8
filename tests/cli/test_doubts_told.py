"""What speaks against an image is said and kept in the report."""

import json

import numpy as np
import pytest

from napari_deltamic.images.stacks import read_image, write_image


def test_doubts_are_said_and_reported(data, tmp_path, run):
    given = "fit", data / "cell.tif", "--seeds", data / "start.ply", "--max-iterations", "1"
    out = tmp_path / "in order"
    _, _, err = run(*given, "-o", out)
    assert "too large" not in err
    assert json.loads((out / "report.json").read_text())["sanity"] == []
    out = tmp_path / "four times"
    _, _, err = run(*given, "--voxel-size", "1.5", "0.2", "0.2", "-o", out)
    assert "step along Z too large" in err
    report = json.loads((out / "report.json").read_text())
    assert "voxel size" in [doubt["kind"] for doubt in report["sanity"]]
    assert any("step along Z too large" in text for text in report["warnings"])


@pytest.mark.usefixtures("judged")
def test_no_fit_with_a_doubtful_voxel_size_is_good(data, tmp_path, run):
    """Shapes of another scale explain the image as well."""
    given = "fit", data / "cell.tif", "--seeds", data / "labels.tif"
    for size, grade in (("0.3", "good"), ("1.2", "fair")):
        run(*given, "--voxel-size", size, "0.2", "0.2", "-o", tmp_path / size)
        verdict = json.loads((tmp_path / size / "report.json").read_text())["verdict"]
        assert verdict["grade"] == grade
        assert ("step along Z too large" in "; ".join(verdict["reasons"])) == (grade == "fair")


def test_padding_is_told_and_left_out(data, tmp_path, run):
    image, _ = read_image(data / "cell.tif")
    padded = image.astype(np.float32) + 100
    padded[:2], padded[:, :, :3] = 0, 0
    write_image(tmp_path / "turned.tif", padded, (0.2, 0.2, 0.2))
    given = "--seeds", data / "start.ply", "--max-iterations", "1", "-o", tmp_path / "out"
    code, _, err = run("fit", tmp_path / "turned.tif", *given)
    assert code == 0
    assert "turned.tif: " in err
    assert "padding, all of one value: taken as missing" in err


@pytest.mark.usefixtures("judged")
def test_hot_voxels_lower_no_grade(data, tmp_path, run):
    image, _ = read_image(data / "cell.tif")
    hot = image.copy()
    hot[5, 6, 7] = hot[12, 11, 16] = 200 * image.max()
    write_image(tmp_path / "hot.tif", hot, (0.3, 0.2, 0.2))
    verdicts = []
    for path in (data / "cell.tif", tmp_path / "hot.tif"):
        out = tmp_path / path.stem
        _, _, err = run("fit", path, "--seeds", data / "labels.tif", "-o", out)
        assert ("note: 2 hot voxels" in err) == (path.stem == "hot")
        verdicts.append(json.loads((out / "report.json").read_text())["verdict"])
    assert verdicts[0]["grade"] == verdicts[1]["grade"] != "poor"
    assert verdicts[0]["reasons"] == verdicts[1]["reasons"]


@pytest.mark.slow
def test_an_uneven_background_is_told_and_fitted(data, tmp_path, run):
    image, _ = read_image(data / "cell.tif")
    rising = image.astype(np.float32) + np.linspace(0, 3, image.shape[2]) * np.ptp(image)
    write_image(tmp_path / "rising.tif", rising, (0.2, 0.2, 0.2))
    given = "fit", tmp_path / "rising.tif", "--seeds", data / "start.ply", "--max-iterations", "1"
    _, _, err = run(*given, "-o", tmp_path / "out")
    assert "the background varies by" in err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [effect["name"] for effect in report["effects"]] == ["background"]
    for effects, told in (("auto", True), ("none", False)):
        _, _, err = run(*given, "--effects", effects, "-o", tmp_path / effects)
        assert ("the background varies by" in err) == told
