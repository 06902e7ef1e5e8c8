import os

import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings, validated

SCENE = {"voxel_size": (0.25, 0.1, 0.1)}


def settings(image="image.tif", seeds="seeds.csv", fit=None, **scene):
    return RunSettings(
        image=image,
        seeds=seeds,
        scene=SceneSettings(**SCENE, **scene),
        fit=FitSettings(**(fit or {})),
    )


def round_trip(run, folder):
    path = folder / "run.toml"
    path.write_bytes(run.to_toml().encode())
    return RunSettings.from_toml(path)


@pytest.mark.parametrize(
    "fit",
    [
        {},
        {"levels": (3.5, 1.0), "smoothing": 0.0, "density": "smooth", "fit_psf": True},
        {"accuracy": 0, "tolerance": 1e-12, "bending": 1e300, "likelihood": "paper"},
    ],
)
def test_toml_round_trip(tmp_path, fit):
    for scene in ({}, {"sigma": (0.3, 0.1, 0.1), "origin": (-1e-9, 1e9, 0), "effects": ()}):
        run = settings(fit=fit, **scene)
        assert round_trip(run, tmp_path) == run


@pytest.mark.parametrize(
    "name",
    [
        "quote\" and 'single'",
        "C:\\new\\table.tif",
        "line\nbreak\ttab\rreturn",
        "Zellmembran-Größe µm 細胞 🧫.tif",
        "# = [x]",
        "\x00\x1f\x7f\x85\u2028",
        "",
    ],
)
def test_odd_characters_in_paths(tmp_path, name):
    run = settings(image=name, seeds=name)
    assert round_trip(run, tmp_path) == run


def test_a_path_that_is_not_unicode(tmp_path):
    # Linux allows any bytes in a name; Python shows them as lone surrogates.
    name = os.fsdecode(b"caf\xe9.tif")
    if name == "café.tif":
        pytest.skip("file names are not UTF-8 here")
    with pytest.raises(InputError, match="name"):
        round_trip(settings(image=name), tmp_path)


def refused(folder, text, message):
    path = folder / "run.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(InputError, match=message) as error:
        RunSettings.from_toml(path)
    assert "\n" not in str(error.value)


GOOD = 'image = "a"\nseeds = "b"\n[scene]\nvoxel_size = [1, 1, 1]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "image: it must be given"),
        ('image = "a"\nseeds = "b"\n', "scene"),
        ("colour = 1\n" + GOOD, "colour: there is no such setting"),
        (GOOD + "zoom = 2\n", "scene.zoom: there is no such setting"),
        (GOOD + "[fit]\nspeed = 1\n", "fit.speed: there is no such setting"),
        (GOOD + "fit = 3\n", "scene.fit: there is no such setting"),
        ("fit = 3\n" + GOOD, "fit: a table is needed"),
        (GOOD + 'sigma = "wide"\n', "scene.sigma"),
        (GOOD + "sigma = [1, 1]\n", "scene.sigma"),
        (GOOD + "sigma = [1, 1, 0]\n", "scene.sigma: sigma must be positive"),
        (GOOD + "sigma = [1, 1, nan]\n", "scene.sigma: sigma must be positive"),
        (GOOD + 'effects = ["magic"]\n', "unknown effect 'magic': choose from pixel_integration"),
        (GOOD.replace("[1, 1, 1]", "[1, -1, 1]"), "voxel size must be three positive numbers"),
        (GOOD.replace("[1, 1, 1]", "[inf, 1, 1]"), "voxel size must be three positive numbers"),
        (GOOD + "[fit]\naccuracy = 1\n", "fit.accuracy"),
        (GOOD + "[fit]\naccuracy = nan\n", "fit.accuracy"),
        (GOOD + '[fit]\ndensity = "rough"\n', "fit.density"),
        (GOOD + "[fit]\nmax_iterations = 0\n", "fit.max_iterations"),
        (GOOD + "[fit]\nmax_iterations = 1.5\n", "fit.max_iterations"),
        (GOOD + "[fit]\nlevels = []\n", "levels must decrease and end at 1"),
        (GOOD + "[fit\n", "cannot read settings"),
        ("\xff\xfe".encode("latin-1"), "cannot read settings"),
    ],
)
def test_refuses_in_one_line(tmp_path, text, message):
    refused(tmp_path, text, message)


@pytest.mark.parametrize("name", ["bending", "reach", "tolerance", "smoothing"])
@pytest.mark.parametrize("value", [-1, float("nan"), float("inf")])
def test_numbers_of_the_fit_are_positive_and_finite(name, value):
    with pytest.raises(InputError, match=name):
        validated(FitSettings, {name: value})


def test_origin_is_finite():
    with pytest.raises(InputError, match="origin"):
        validated(SceneSettings, {**SCENE, "origin": (0, 0, float("nan"))})


def test_refuses_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot read settings"):
        RunSettings.from_toml(tmp_path / "run.toml")
    with pytest.raises(InputError, match="cannot read settings"):
        RunSettings.from_toml(tmp_path)


@pytest.mark.parametrize(
    "levels", [(), (2.0,), (1.0, 2.0), (2.0, 3.0, 1.0), (2.0, 0.5), (1.0, 1.0), (float("inf"), 1.0)]
)
def test_levels_decrease_and_end_at_one(levels):
    with pytest.raises(InputError, match="levels"):
        validated(FitSettings, {"levels": levels})


def test_good_levels():
    assert validated(FitSettings, {"levels": [3, 1]}).levels == (3.0, 1.0)
    assert validated(FitSettings, {"levels": [1]}).levels == (1.0,)
    assert validated(FitSettings, {}).levels is None


def test_settings_do_not_change():
    with pytest.raises(ValueError, match="frozen"):
        FitSettings().step = 1
