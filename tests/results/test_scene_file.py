"""Scenes on disk: whole and to the bit, or refused in one line."""

import json
import zipfile

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.results.scene_file import load_scene, save_scene
from napari_deltamic.runs.optics_settings import optics_from_values
from napari_deltamic.scene import (
    Filament,
    Points,
    Scene,
    Solid,
    Surface,
    render_scene,
)
from napari_deltamic.scene.effects import Effects

GRID = nd.Grid((16, 18, 17), (0.2, 0.2, 0.2))
BALL = sphere((1.5, 1.7, 1.6), 0.7, subdivisions=1)
PATH = np.array([[1.0, 1.0, 1.0], [1.5, 2.0, 1.2], [2.0, 1.5, 2.0]])
SCENE = Scene(
    (
        Surface(BALL, np.linspace(0.5, 2, len(BALL.faces))),
        Solid(BALL, {1: 0.4}),
        Filament(torch.tensor(PATH), density=3.0),
        Points(PATH, torch.tensor([1.0, 2.0, 3.0])),
    ),
    nd.GaussianPSF((0.3, 0.25, 0.25)),
    Effects.from_text("attenuation=0.05,camera:gain=2:offset=100"),
)


@pytest.fixture
def path(tmp_path):
    save_scene(SCENE, tmp_path / "scene.zip")
    return tmp_path / "scene.zip"


def test_a_scene_comes_back_to_the_bit(path):
    back = load_scene(path)
    assert [type(s) for s in back.structures] == [type(s) for s in SCENE.structures]
    assert back.effects == SCENE.effects
    assert torch.equal(render_scene(back, GRID), render_scene(SCENE, GRID))
    # Faces that two structures share are written once.
    assert sum("corners" in n for n in zipfile.ZipFile(path).namelist()) == 1


def test_a_tilted_psf_comes_back(tmp_path):
    tilted = nd.GaussianPSF(covariance=[[0.09, 0.02, 0.0], [0.02, 0.06, 0.0], [0.0, 0.0, 0.07]])
    save_scene(Scene(Points(PATH), tilted), tmp_path / "a.zip")
    back = load_scene(tmp_path / "a.zip").optics
    assert not back.diagonal
    np.testing.assert_allclose(back.covariance, tilted.covariance, rtol=1e-12)


def changed(path, **facts):
    """Without those that are None."""
    with zipfile.ZipFile(path) as file:
        members = {n: file.read(n) for n in file.namelist()}
    scene = {**json.loads(members["scene.json"]), **facts}
    scene = {name: values for name, values in scene.items() if values is not None}
    members["scene.json"] = json.dumps(scene).encode()
    with zipfile.ZipFile(path, "w") as file:
        for name, data in members.items():
            file.writestr(name, data)


BAD = {
    "later": ({"format": 99}, "format 99"),
    "kind": ({"structures": [{"kind": "cloud"}]}, "kind 'cloud'"),
    "nothing": ({"structures": []}, "needs a structure"),
    "array": ({"structures": [{"kind": "points", "places": "none", "weight": 1}]}, "no none"),
    "effect": ({"effects": {"magic": {}}}, r"one .unknown effect 'magic'"),
    "no effects": ({"effects": None}, "there is no 'effects'"),
    "field": ({"effects": {"halo": {"size": 1}}}, "halo.size: there is no such setting"),
    "optics": ({"optics": {"kind": "gaussian", "sigma": [0, 1, 1]}}, "sigma must be positive"),
    "kind of optics": ({"optics": {"kind": "magic"}}, "optics"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_scene_is_refused(path, name):
    facts, says = BAD[name]
    changed(path, **facts)
    with pytest.raises(nd.InputError, match=says) as error:
        load_scene(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_files_that_are_none(tmp_path):
    with pytest.raises(nd.InputError, match="no such file"):
        load_scene(tmp_path / "none.zip")
    (tmp_path / "text.zip").write_text("hello")
    with pytest.raises(nd.InputError, match="not a scene"):
        load_scene(tmp_path / "text.zip")


def test_other_optics_are_saved_as_their_settings(tmp_path):
    settings = optics_from_values({"kind": "microscope", "na": 1.2, "wavelength": 0.52})
    scene = Scene(Points(PATH), settings.build())
    with pytest.raises(nd.InputError, match="give its settings"):
        save_scene(scene, tmp_path / "a.zip")
    assert not (tmp_path / "a.zip").exists()
    save_scene(scene, tmp_path / "a.zip", settings)
    back = load_scene(tmp_path / "a.zip")
    assert torch.equal(render_scene(back, GRID), render_scene(scene, GRID))
