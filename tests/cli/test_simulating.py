"""``napari-deltamic simulate``: what it writes can be fitted, repeated, and is as asked."""

import json

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.images.stacks import read_image
from napari_deltamic.measure import surface_distance
from napari_deltamic.results.simulation_files import FILES
from napari_deltamic.runs.settings import RunSettings

SHAPE = ("--shape", 20, 24, 26)
SIZE = ("--voxel-size", 0.3, 0.2, 0.2)
SIGMA = ("--sigma", 0.36, 0.24, 0.24)
SCENE = (*SHAPE, *SIZE, *SIGMA)


def test_the_image_can_be_fitted(run, tmp_path):
    made, fitted = tmp_path / "made", tmp_path / "fitted"
    code, out, _ = run("simulate", "--cells", 1, *SCENE, "--photons", 200, "-o", made)
    assert code == 0
    assert out == [str(made / name) for name in FILES]
    code, _, err = run(
        "fit", made / "image.tif", "--seeds", made / "labels.tif", *SIGMA, "-o", fitted
    )
    assert code == 0, err
    truth, found = (nd.load_mesh(folder / "mesh.rec") for folder in (made, fitted))
    assert surface_distance(found, truth, 3000).mean < 0.3 * 0.2


def test_settings_of_the_fit_hold_the_truth(run, tmp_path):
    effects = "attenuation=0.02,camera:gain=2:offset=100:read_noise=1.5"
    code, _, _ = run("simulate", "--cells", 2, *SCENE, "--effects", effects, "-o", tmp_path)
    assert code == 0
    settings = RunSettings.from_toml(tmp_path / "run.toml")
    assert settings.scene.sigma == (0.36, 0.24, 0.24)
    assert settings.scene.effects.camera.gain == 2
    truth = json.loads((tmp_path / "parameters.json").read_text())
    assert truth["effects"]["attenuation"]["per_um"] == 0.02
    assert truth["photons"] == pytest.approx(100)
    assert truth["optics"]["sigma_um"] == [0.36, 0.24, 0.24]
    volumes = nd.load_mesh(tmp_path / "mesh.ply").volumes()
    assert truth["volumes_um3"] == pytest.approx({str(k): v for k, v in volumes.items()})


def test_cells_can_shine_from_inside(run, tmp_path):
    images = []
    for interior in (0.0, 0.5):
        folder = tmp_path / str(interior)
        given = ("--cells", 1, *SCENE, "--photons-per-um2", 2000, "--interior", interior)
        code, _, err = run("simulate", *given, "-o", folder)
        assert code == 0, err
        images.append(read_image(folder / "noise_free.tif")[0].astype(float))
        truth = json.loads((folder / "parameters.json").read_text())
    assert truth["structures"] == ["surface", "solid"]
    assert truth["interiors"] == [[0.5]]
    background = np.percentile(images[0], 1), np.percentile(images[1], 1)
    total = (images[1] - background[1]).sum() - (images[0] - background[0]).sum()
    assert total == pytest.approx(2000 * 0.5 * truth["volumes_um3"]["1"], rel=0.1)


def test_the_same_seed_gives_the_same_files(run, tmp_path):
    options = ("simulate", "--cells", 2, *SCENE, "--seed", 3, "-o")
    for name in ("one", "same"):
        run(*options, tmp_path / name)
    for name in FILES:
        if name != "run.toml":  # names its folder
            one, same = (tmp_path / folder / name for folder in ("one", "same"))
            assert one.read_bytes() == same.read_bytes(), name


def test_a_set_has_a_folder_for_each_seed(run, tmp_path):
    code, out, _ = run(
        "simulate", "--cells", 2, "--kind", "vesicles", *SCENE, "--seed", 7, "--count", 3, "-o",
        tmp_path,
    )  # fmt: skip
    assert code == 0
    assert out == [str(tmp_path / f"{k:05}") for k in range(3)]
    seeds = [json.loads((tmp_path / f"{k:05}/parameters.json").read_text())["seed"] for k in (0, 2)]
    assert seeds == [7, 9]
    run("simulate", "--cells", 2, "--kind", "vesicles", *SCENE, "--seed", 9, "-o", tmp_path / "a")
    last, alone = (tmp_path / f / "image.tif" for f in ("00002", "a"))
    assert last.read_bytes() == alone.read_bytes()


def test_a_mesh_can_be_given(run, data, tmp_path):
    options = ("--photons-per-um2", 500, "--background", 3, "--bits", 32)
    code, _, _ = run("simulate", data / "start.ply", *SCENE, *options, "-o", tmp_path)
    assert code == 0
    image, size = read_image(tmp_path / "image.tif")
    assert image.dtype == np.float32
    assert size == pytest.approx((0.3, 0.2, 0.2))
    labels, _ = read_image(tmp_path / "labels.tif")
    assert set(np.unique(labels)) == {0, 1}
    free, _ = read_image(tmp_path / "noise_free.tif")
    assert free.min() == pytest.approx(3, abs=0.01)


def test_the_psf_of_an_objective_is_in_the_settings(run, tmp_path):
    objective = ("--na", 0.9, "--wavelength", 0.52, "--immersion", "water")
    code, _, _ = run("simulate", "--cells", 1, *SHAPE, *SIZE, *objective, "-o", tmp_path)
    assert code == 0
    settings = RunSettings.from_toml(tmp_path / "run.toml").scene
    assert settings.sigma is None
    assert settings.optics.na == 0.9
    truth = json.loads((tmp_path / "parameters.json").read_text())
    assert truth["optics"]["na"] == pytest.approx(0.9)


def test_effects_without_numbers_are_remarked(run, tmp_path):
    code, _, err = run("simulate", "--cells", 1, *SCENE, "--effects", "attenuation", "-o", tmp_path)
    assert code == 0
    assert "the effect attenuation changes nothing without its numbers" in err


BAD = {
    "neither": ((), "needs MESH or --cells"),
    "both": (("{mesh}", "--cells", 2), "not both"),
    "kind": (("{mesh}", "--kind", "foam"), "--kind goes with --cells"),
    "no such kind": (("--cells", 2, "--kind", "cubes"), "invalid choice: 'cubes'"),
    "no cells": (("--cells", 0), "must be 1 or more"),
    "many cells": (("--cells", 1000), "no room for 1000 cells"),
    "shape": (("--cells", 1, "--shape", 20, 24, 0), "shape of three positive"),
    "voxel size": (("--cells", 1, "--voxel-size", 0, 1, 1), "voxel size must be three positive"),
    "sigma": (("--cells", 1, "--sigma", 0, 1, 1), "sigma must be positive"),
    "two PSFs": (("--cells", 1, "--na", 1.2), "both say what the PSF is"),
    "photons": (("--cells", 1, "--photons", 0), "photons must be positive"),
    "photons nan": (("--cells", 1, "--photons", "nan"), "photons must be positive"),
    "background": (("--cells", 1, "--background", -1), "background must be"),
    "bits": (("--cells", 1, "--bits", 10), "invalid choice: 10"),
    "too bright": (("--cells", 1, "--photons", 1e6), "16 bits hold 65535"),
    "seed": (("--cells", 1, "--seed", -1), "a seed is a whole number"),
    "count": (("--cells", 1, "--count", 0), "--count must be 1 to"),
    "effect": (("--cells", 1, "--effects", "magic"), "unknown effect 'magic'"),
    "effect's number": (("--cells", 1, "--effects", "attenuation=7"), "attenuation"),
    "missing mesh": (("none.ply",), "no such file"),
    "outside": (("{mesh}", "--voxel-size", 0.001, 0.001, 0.001), "outside the image"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(fails, data, tmp_path, name):
    options, says = BAD[name]
    options = [str(o).format(mesh=data / "start.ply") for o in options]
    out = tmp_path / "out"
    assert says in fails("simulate", *SCENE, *options, "-o", out)
    assert not out.exists()


def test_nothing_is_written_over(fails, run, tmp_path):
    (tmp_path / "image.tif").write_text("precious")
    options = ("simulate", "--cells", 1, *SCENE, "-o", tmp_path)
    assert "holds image.tif; --overwrite" in fails(*options)
    assert (tmp_path / "image.tif").read_text() == "precious"
    assert run(*options, "--overwrite")[0] == 0
    file = tmp_path / "file"
    file.write_text("")
    assert "is a file, not a folder" in fails(*options[:-1], file)
