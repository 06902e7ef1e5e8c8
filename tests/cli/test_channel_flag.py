"""``--channel``: every command that reads an image takes one of several; what cannot be is said."""

import csv
import json
import shlex

import numpy as np
import pytest
import tifffile

from napari_deltamic.accuracy import machine_costs
from napari_deltamic.fourier.cost import BUILT_IN
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.runs.command import command
from napari_deltamic.runs.settings import RunSettings

SIZE = (0.3, 0.2, 0.2)
SIGMA = ("--sigma", "0.36", "0.24", "0.24")
FAST = ("--max-iterations", "3", *SIGMA)
NAMES = ["DAPI", "cell membrane", "GFP"]


@pytest.fixture(scope="session")
def channels(data):
    """A folder with the cell as the second of three channels, and what can start a fit."""
    folder = data.parent / "channels"
    folder.mkdir(exist_ok=True)
    pixels, _ = read_image(data / "cell.tif")
    rng = np.random.default_rng(1)
    other = rng.poisson(50, pixels.shape).astype(np.float32)
    stack = np.stack([other, pixels, 1000 - pixels])
    metadata = {"axes": "CZYX", "Channel": {"Name": NAMES}}
    for name, side in zip("ZYX", SIZE, strict=True):
        metadata |= {f"PhysicalSize{name}": side, f"PhysicalSize{name}Unit": "µm"}
    options = {"ome": True, "photometric": "minisblack"}
    tifffile.imwrite(folder / "cells.ome.tif", stack, metadata=metadata, **options)
    series = {**metadata, "axes": "TCZYX"}
    tifffile.imwrite(folder / "movie.ome.tif", np.stack([stack] * 2), metadata=series, **options)
    (folder / "cells_seeds.ply").write_bytes((data / "start.ply").read_bytes())
    return folder


def arguments(channels, *more):
    return (
        "fit",
        channels / "cells.ome.tif",
        "--seeds",
        channels / "cells_seeds.ply",
        *FAST,
        *more,
    )


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "channel",
    [pytest.param("2", marks=SLOW), "cell membrane", pytest.param("Cell Membrane", marks=SLOW)],
)
def test_a_channel_is_fitted_as_if_it_were_alone(data, channels, run, tmp_path, channel):
    alone = ("fit", data / "cell.tif", "--seeds", data / "start.ply", *FAST)
    assert run(*alone, "-o", tmp_path / "alone")[0] == 0
    code, _, err = run(*arguments(channels, "--channel", channel, "-o", tmp_path / "out"))
    assert code == 0, err
    for name in ("mesh.ply", "rendered.tif"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()
    saved = RunSettings.from_toml(tmp_path / "out" / "run.toml")
    assert saved.channel == channel
    # It can be run again, from the file and from the command that it stands for.
    again = ("fit", "--settings", tmp_path / "out" / "run.toml", "-o", tmp_path / "again")
    assert run(*again)[0] == 0
    words = shlex.split(command(saved, str(tmp_path / "copied")))[1:]
    assert words[words.index("--channel") + 1] == channel
    assert run(*words)[0] == 0
    for folder in ("again", "copied"):
        assert (tmp_path / folder / "mesh.ply").read_bytes() == (
            tmp_path / "alone" / "mesh.ply"
        ).read_bytes()


def test_settings_may_say_a_number(channels, run, tmp_path):
    assert run(*arguments(channels, "--channel", "2", "-o", tmp_path / "out"))[0] == 0
    toml = tmp_path / "out" / "run.toml"
    toml.write_text(toml.read_text().replace('channel = "2"', "channel = 2"))
    assert RunSettings.from_toml(toml).channel == "2"


BAD = {
    "none": ((), "has 3 channels (1 DAPI, 2 cell membrane, 3 GFP): choose one with --channel"),
    "0": (("--channel", "0"), "the first is 1, as in Fiji: there is no channel 0"),
    "-1": (("--channel", "-1"), "the first is 1, as in Fiji: there is no channel -1"),
    "5": (("--channel", "5"), "there is no channel '5': the image has 3 channels (1 DAPI, 2"),
    "2.5": (("--channel", "2.5"), "there is no channel '2.5': the image has 3 channels"),
    "unknown": (("--channel", "actin"), "no channel 'actin': the image has 3 channels (1 DAPI"),
    "empty": (("--channel", ""), "a number, from 1, or a name is needed"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be(channels, fails, tmp_path, name):
    words, says = BAD[name]
    assert says in fails(*arguments(channels, *words, "-o", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_images_without_such_channels(data, fails, tmp_path):
    flat = tmp_path / "flat.tif"
    tifffile.imwrite(flat, np.ones((3, 9, 9), np.uint8), imagej=True, metadata={"axes": "CYX"})
    colours = tmp_path / "rgb.tif"
    tifffile.imwrite(colours, np.ones((9, 9, 9, 3), np.uint8), photometric="rgb")
    np.save(tmp_path / "a.npy", np.ones((3, 9, 9, 9)))
    for image, channel, says in (
        (data / "cell.tif", "2", "no channel '2', the image has one only: leave out --channel"),
        (data / "cell.tif", "GFP", "the image has one only: leave out --channel"),
        (flat, "2", "a 3D stack (Z, Y, X) is needed, not a 2D image of 3 channels"),
        (colours, None, "has 3 channels (1 red, 2 green, 3 blue): choose one with --channel"),
        (colours, "4", "there is no channel '4': the image has 3 channels (1 red"),
        (tmp_path / "a.npy", "2", "does not say which of its axes are channels"),
    ):
        words = () if channel is None else ("--channel", channel)
        more = ("--voxel-size", "0.3", "0.2", "0.2", "--seeds", data / "start.ply", *SIGMA)
        assert says in fails("fit", image, *words, *more, "-o", tmp_path / "out")


@pytest.mark.parametrize("value", ["0", "true", "1.5", '""'])
def test_settings_with_a_channel_that_cannot_be(fails, tmp_path, value):
    path = tmp_path / "run.toml"
    path.write_text(f'image="a.tif"\nseeds="b"\nchannel={value}\nscene={{voxel_size=[1,1,1]}}')
    assert "channel: " in fails("fit", "--settings", path, "-o", tmp_path / "out")


def test_the_only_channel_may_be_named(data, run, tmp_path):
    words = ("fit", data / "cell.tif", "--channel", "1", "--seeds", data / "start.ply", *FAST)
    assert run(*words, "-o", tmp_path / "out")[0] == 0


def test_a_series(channels, run, fails, tmp_path):
    words = ("track", channels / "movie.ome.tif", "--seeds", channels / "cells_seeds.ply", *SIGMA)
    said = fails(*words, "-o", tmp_path / "none")
    assert "has 3 channels (1 DAPI, 2 cell membrane, 3 GFP): choose one with --channel" in said
    fast = ("--levels", "1", "--accuracy", "2e-2", "--no-collisions", "--no-divisions")
    code, _, err = run(*words, *fast, "--channel", "cell membrane", "-o", tmp_path / "out")
    assert code == 0, err
    assert 'channel = "cell membrane"' in (tmp_path / "out" / "run.toml").read_text()
    rows = list(csv.DictReader((tmp_path / "out" / "tracks.csv").read_text().splitlines()))
    assert [row["frame"] for row in rows] == ["0", "1"]


def test_a_batch(channels, run, tmp_path):
    folder = tmp_path / "stacks"
    folder.mkdir()
    for name in ("cells.ome.tif", "cells_seeds.ply"):
        (folder / name).write_bytes((channels / name).read_bytes())
    words = ("batch", folder, "--seeds", "{stem}_seeds.ply", "--workers", "0", *FAST)
    code, _, err = run(*words, "-o", tmp_path / "none")
    assert code == 1
    assert "choose one with --channel" in err
    code, _, err = run(*words, "--channel", "2", "-o", tmp_path / "out")
    assert code == 0, err
    assert (tmp_path / "out" / "cells" / "mesh.ply").is_file()


def test_effects(channels, run, fails, tmp_path):
    image, seeds = channels / "cells.ome.tif", channels / "cells_seeds.ply"
    words = ("effects", image, "--seeds", seeds, "--candidates", "attenuation", *FAST)
    assert "choose one with --channel" in fails(*words)
    code, lines, err = run(*words, "--channel", "2", "--json", tmp_path / "a.json")
    assert code == 0, err
    assert any(line.startswith("attenuation") for line in lines)
    assert json.loads((tmp_path / "a.json").read_text())["evidence"]


def test_accuracy(channels, data, run, fails, monkeypatch):
    monkeypatch.setattr("napari_deltamic.cli.accuracy_command.costs", lambda again: BUILT_IN)
    monkeypatch.setattr(machine_costs, "_known", {})
    words = (
        "accuracy",
        channels / "cells.ome.tif",
        "--seeds",
        channels / "cells_seeds.ply",
        *SIGMA,
    )
    assert "choose one with --channel" in fails(*words)
    code, out, err = run(*words, "--channel", "2", "--budget", "0.01")
    assert code == 0, err
    alone = ("accuracy", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA)
    code, expected, err = run(*alone, "--budget", "0.01")
    assert code == 0, err
    noise = [line for line in out if line.startswith(("noise", "accuracy in use"))]
    assert noise == [line for line in expected if line.startswith(("noise", "accuracy in use"))]
    assert len(noise) == 2
    mesh = ("accuracy", data / "start.ply", "--shape", "20", "24", "24", "--voxel-size", *SIZE)
    assert "--channel goes with an image" in fails(*mesh, *SIGMA, "--channel", "2")


def test_measure_knows_the_channel_that_was_fitted(channels, data, run, fails, tmp_path):
    assert run(*arguments(channels, "--channel", "2", "-o", tmp_path / "fit"))[0] == 0
    words = ("measure", tmp_path / "fit", "--images", "tif")
    code, _, err = run(*words, "-o", tmp_path / "out")
    assert code == 0, err
    # The image of the folder is elsewhere now: its channel is still known, or said.
    moved = tmp_path / "moved.ome.tif"
    moved.write_bytes((channels / "cells.ome.tif").read_bytes())
    for k, more in enumerate(((), ("--channel", "cell membrane"))):
        folder = tmp_path / f"moved{k}"
        code, _, err = run(*words, "--image", moved, *more, "-o", folder)
        assert code == 0, err
        residual = read_image(folder / "residual.ome.tif")[0]
        np.testing.assert_array_equal(residual, read_image(tmp_path / "out/residual.ome.tif")[0])
    mesh = ("measure", data / "start.ply", "--image", moved)
    assert "choose one with --channel" in fails(*mesh, "-o", tmp_path / "none")
    code, _, err = run(*mesh, "--channel", "2", "-o", tmp_path / "mesh")
    assert code == 0, err


def test_measure_another_channel(channels, data, run, fails, tmp_path):
    """One of the same image, or a file of its own: the same numbers."""
    assert run(*arguments(channels, "--channel", "2", "-o", tmp_path / "fit"))[0] == 0
    write_image(tmp_path / "gfp.tif", read_image(channels / "cells.ome.tif", "3")[0], SIZE)
    words = ("measure", tmp_path / "fit", "--other-channel-on", "walls")
    found = []
    for k, other in enumerate(("GFP", "3", tmp_path / "gfp.tif")):
        code, _, err = run(*words, "--other-channel", other, "-o", tmp_path / f"out{k}")
        assert code == 0, err
        found.append((tmp_path / f"out{k}" / "channel_walls.csv").read_text())
    assert found[0] == found[1] == found[2]
    said = fails(*words, "--other-channel", "actin", "-o", tmp_path / "none")
    assert "there is no channel 'actin': the image has 3 channels (1 DAPI" in said
    said = fails(*words, "--channel", tmp_path / "gfp.tif", "-o", tmp_path / "none")
    assert "--channel is one of the image: give a file to --other-channel" in said
    said = fails(*words, "--other-channel", tmp_path / "gone.tif", "-o", tmp_path / "none")
    assert "there is no such file" in said
