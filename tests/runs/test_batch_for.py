"""A batch file from the settings of one run, as the window writes it."""

import shlex

import numpy as np
import pytest

from napari_deltamic.cli import build_parser
from napari_deltamic.errors import InputError
from napari_deltamic.images.stacks import write_image
from napari_deltamic.runs.batch import batch_for, batch_jobs, write_batch
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene.effects import Effects

SETTINGS = RunSettings(
    image="x.tif",
    seeds="y.ply",
    scene=SceneSettings(
        voxel_size=(0.3, 0.2, 0.2), sigma=(0.4, 0.3, 0.3), effects=Effects.from_text("background")
    ),
    fit=FitSettings(fit_psf=False, max_iterations=7),
)


@pytest.fixture
def folder(tmp_path):
    for name in ("a", "b [1]"):
        write_image(tmp_path / f"{name}.tif", np.ones((4, 5, 6), np.float32), (0.3, 0.2, 0.2))
    return tmp_path


def test_what_is_fitted_and_how(folder):
    words = shlex.split(write_batch(folder, SETTINGS))
    assert words == [
        "napari-deltamic", "batch", str(folder / "batch.toml"), "-o", str(folder / "results"),
    ]  # fmt: skip
    jobs = batch_jobs(folder / "batch.toml")
    assert [(job.name, job.image, job.seeds) for job in jobs] == [
        (name, folder / f"{name}.tif", "auto") for name in ("a", "b [1]")
    ]
    parsed = build_parser().parse_args(jobs[0].words(folder))
    assert (parsed.fit_psf, parsed.max_iterations) == (False, 7)
    assert parsed.sigma == [0.4, 0.3, 0.3]
    assert parsed.effects == SETTINGS.scene.effects.to_text()
    assert parsed.voxel_size is None  # each file says its own
    with pytest.raises(InputError, match="is there already"):
        write_batch(folder, SETTINGS)


def test_a_voxel_size_is_given_where_a_file_has_none(folder):
    """Only there: those of the other files stand."""
    np.save(folder / "c.npy", np.ones((4, 5, 6)))
    write_batch(folder, SETTINGS)
    parser = build_parser()
    sizes = {
        job.name: parser.parse_args(job.words(folder)).voxel_size
        for job in batch_jobs(folder / "batch.toml")
    }
    assert sizes == {"a": None, "b [1]": None, "c": [0.3, 0.2, 0.2]}


def test_seeds_beside_the_stacks(folder):
    write_image(folder / "a_labels.tif", np.ones((4, 5, 6), np.uint16), (0.3, 0.2, 0.2))
    made = batch_for(folder, SETTINGS)
    assert made.seeds == "{stem}_labels.tif"
    assert made.images == ("a.tif", "b [1].tif")


def test_what_is_of_one_image_only(tmp_path, folder):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="there is no image"):
        batch_for(tmp_path / "empty", SETTINGS)
    second = Effects.from_text("second_view:sigma=[0.3,0.3,0.3]")
    scene = SETTINGS.scene.model_copy(update={"effects": second})
    with pytest.raises(InputError, match="belongs to one image"):
        batch_for(folder, SETTINGS.model_copy(update={"scene": scene}))
