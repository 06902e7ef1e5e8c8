"""``--levels``: the coarse-to-fine schedule, which a mesh file of seeds cannot tell."""

import pytest

from napari_deltamic.runs.settings import NEAR_LEVELS, RunSettings


def test_levels_are_taken_and_kept(data, tmp_path, run, seen):
    out = tmp_path / "out"
    code, _, err = run(
        "fit", data / "cell.tif", "--seeds", data / "start.ply",
        "--levels", *map(str, NEAR_LEVELS), "-o", out,
    )  # fmt: skip
    assert code == 0, err
    assert seen[0][1]["settings"].levels == NEAR_LEVELS
    assert RunSettings.from_toml(out / "run.toml").fit.levels == NEAR_LEVELS
    run("fit", "--settings", out / "run.toml", "--levels", "2", "1", "-o", tmp_path / "again")
    assert seen[1][1]["settings"].levels == (2, 1)


@pytest.mark.parametrize("levels", [("1", "2"), ("3", "2"), ("0.5", "1"), ("nan", "1")])
def test_levels_that_make_no_sense_are_refused(data, tmp_path, fails, levels):
    said = fails(
        "fit", data / "cell.tif", "--seeds", data / "start.ply", "--levels", *levels,
        "-o", tmp_path / "out",
    )  # fmt: skip
    assert "levels" in said
