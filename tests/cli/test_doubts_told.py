"""What speaks against an image is said and kept in the report."""

import json


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
