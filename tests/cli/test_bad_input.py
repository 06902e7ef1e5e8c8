"""The command line: one line, and nothing written, for whatever it cannot use."""

import io
import os

import numpy as np
import pytest

from napari_deltamic.cli import main

SHAPE = (20, 24, 24)
VOXELS = ("--voxel-size", "0.3", "0.2", "0.2")
SIGMA = ("--sigma", "0.36", "0.24", "0.24")
FIT = "napari_deltamic.fitting.job.fit"


def new(path, content):
    path.write_text(content)
    return path


def saved(path, array):
    np.save(path, array)
    return path


def cut_short(path, to):
    content = path.read_bytes()
    to.write_bytes(content[: len(content) * 6 // 10])
    return to


def off(path, vertices, faces):
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [" ".join(map(str, row)) for row in (*vertices, *((3, *f) for f in faces))]
    return new(path, "\n".join(lines) + "\n")


IMAGES = {
    "missing": (lambda d, t: t / "none.tif", "there is no such file"),
    "unreadable": (lambda d, t: new(t / "a.tif", "no image"), "not a readable image"),
    "empty file": (lambda d, t: new(t / "a.tif", ""), "the file is empty"),
    "extension": (lambda d, t: new(t / "a.png", "x"), "unknown image extension"),
    "no voxels": (lambda d, t: saved(t / "a.npy", np.zeros((0, 3, 3))), "empty"),
    "2D": (lambda d, t: saved(t / "a.npy", np.eye(9)), "not a 2D image (shape (9, 9))"),
    "channels": (lambda d, t: saved(t / "a.npy", np.ones((9, 9, 9, 2))), "(9, 9, 9, 2)"),
    "complex": (lambda d, t: saved(t / "a.npy", np.ones((9, 9, 9)) * 1j), "complex"),
    "flat": (lambda d, t: saved(t / "a.npy", np.ones((9, 9, 9))), "flat"),
    "NaN": (lambda d, t: d / "nan.tif", "2 NaN voxels; --missing-nan"),
    "cut short": (lambda d, t: cut_short(d / "cell.tif", t / "a.tif"), "it is cut short"),
    "infinite": (lambda d, t: d / "inf.tif", "2 infinite voxels; --missing-nan"),
}


@pytest.mark.parametrize("name", IMAGES)
def test_bad_images(data, tmp_path, fails, name):
    make, says = IMAGES[name]
    path = make(data, tmp_path)
    arguments = ("fit", path, *VOXELS, *SIGMA, "--seeds", data / "start.ply")
    assert says in fails(*arguments, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_nothing_but_nan(data, tmp_path, fails):
    path = saved(tmp_path / "a.npy", np.full((9, 9, 9), np.nan))
    arguments = ("fit", path, *VOXELS, *SIGMA, "--seeds", data / "start.ply", "--missing-nan")
    assert "every voxel" in fails(*arguments, "-o", tmp_path / "out")


TRIANGLE = ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
BALL = "z,y,x,radius\n2.9,2.3,2.3,{:g}\n"
NOISE = np.random.default_rng(0).poisson(20, SHAPE)
SEEDS = {
    "missing": (lambda d, t: t / "none.ply", "there is no such file"),
    "extension": (lambda d, t: new(t / "a.txt", "x"), "unknown extension '.txt' for seeds"),
    "empty file": (lambda d, t: new(t / "a.ply", ""), "the file is empty"),
    "no faces": (lambda d, t: off(t / "a.off", TRIANGLE[0], []), "a.off"),
    "bad index": (lambda d, t: new(t / "a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"), "a.obj"),
    "NaN": (lambda d, t: new(t / "a.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), "a.obj"),
    "outside": (
        lambda d, t: off(t / "a.off", np.add(TRIANGLE[0], 50).tolist(), TRIANGLE[1]),
        "lies outside the image",
    ),
    "other shape": (lambda d, t: saved(t / "a.npy", np.ones((9, 9, 9), int)), "shape (9, 9, 9)"),
    "no labels": (lambda d, t: saved(t / "a.npy", np.zeros(SHAPE, int)), "no labels"),
    "no integers": (lambda d, t: saved(t / "a.npy", np.zeros(SHAPE)), "integers"),
    "header": (lambda d, t: new(t / "a.csv", "a,b\n1,2\n"), "the first line must be z,y,x"),
    "semicolons": (lambda d, t: new(t / "a.csv", "z;y;x\n1,5;2;3\n"), "separated by commas"),
    "no points": (lambda d, t: new(t / "a.csv", "z,y,x\n"), "no points"),
    "no number": (lambda d, t: new(t / "a.csv", "z,y,x\n1,2,three\n"), "line 2"),
    "point outside": (lambda d, t: new(t / "a.csv", "z,y,x\n1,2,90\n"), "outside the image"),
    "radius in nm": (lambda d, t: new(t / "a.csv", BALL.format(900)), "holds the whole image"),
    "radius in m": (lambda d, t: new(t / "a.csv", BALL.format(1e-6)), "smaller than a voxel"),
    "mesh in m": (
        lambda d, t: off(t / "a.off", np.multiply(TRIANGLE[0], 1e-6).tolist(), TRIANGLE[1]),
        "less than a voxel: its numbers must be um",
    ),
    "intensities": (lambda d, t: saved(t / "a.npy", NOISE), "an intensity image?"),
    "radius": (lambda d, t: new(t / "a.csv", "z,y,x,radius\n2,2,2,-1\n"), "radius -1"),
}


@pytest.mark.parametrize("name", SEEDS)
def test_bad_seeds(data, tmp_path, fails, name):
    make, says = SEEDS[name]
    path = make(data, tmp_path)
    arguments = ("fit", data / "cell.npy", *VOXELS, *SIGMA, "--seeds", path)
    assert says in fails(*arguments, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("slices", [1, 2])
@pytest.mark.parametrize("radius", ["", ",radius"])
def test_points_in_few_slices(data, tmp_path, fails, slices, radius):
    image = saved(tmp_path / "a.npy", np.load(data / "cell.npy")[8 : 8 + slices])
    points = new(tmp_path / "a.csv", f"z,y,x{radius}\n0,2.3,2.3{radius and ',1'}\n")
    arguments = ("fit", image, *VOXELS, *SIGMA, "--seeds", points, "-o", tmp_path / "out")
    assert f"3 voxels or more along each axis, not ({slices}, 24, 24)" in fails(*arguments)


SETTINGS = {
    "no TOML": ("a = = 3", "at line 1"),
    "unknown": ("wibble = 3", "wibble: there is no such setting"),
    "nothing": ("", "image: it must be given"),
    "value": ('image="a"\nseeds="b"\nscene={voxel_size=[1,1]}', "voxel_size.2: it must be given"),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_bad_settings_name_their_file(tmp_path, fails, name):
    text, says = SETTINGS[name]
    path = new(tmp_path / "run.toml", text)
    said = fails("fit", "--settings", path, "-o", tmp_path / "out")
    assert f"cannot read settings from {path}: " in said
    assert says in said


def test_a_table_that_cannot_be_written(monkeypatch, capsys):
    class Full(io.StringIO):
        def flush(self):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("sys.stdout", Full())
    assert main(["doctor"]) == 1
    assert "No space left" in capsys.readouterr().err


OPTIONS = {
    "voxel size 0": (("--voxel-size", "0.3", "0", "0.2"), "voxel size must be three positive"),
    "voxel size -1": (("--voxel-size", "0.3", "-1", "0.2"), "voxel size must be three positive"),
    "voxel size nan": (("--voxel-size", "0.3", "nan", "0.2"), "voxel size must be three positive"),
    "two voxel sides": (("--voxel-size", "0.3", "0.2"), "--voxel-size"),
    "sigma 0": (("--sigma", "0.3", "0.2", "0"), "sigma must be positive"),
    "sigma -0.2": (("--sigma", "0.3", "0.2", "-0.2"), "sigma must be positive"),
    "sigma inf": (("--sigma", "0.3", "0.2", "inf"), "sigma must be positive"),
    "sigma in words": (("--sigma", "0.3", "0.2", "wide"), "invalid float value: 'wide'"),
    "accuracy -1": (("--accuracy", "-1"), "accuracy"),
    "accuracy 1": (("--accuracy", "1"), "accuracy"),
    "accuracy nan": (("--accuracy", "nan"), "accuracy"),
    "effect": (("--effects", "magic"), "unknown effect 'magic': choose from"),
    "density": (("--density", "thick"), "invalid choice: 'thick'"),
    "likelihood": (("--likelihood", "great"), "invalid choice: 'great'"),
    "iterations": (("--max-iterations", "0"), "max_iterations"),
    "unknown": (("--fast",), "unrecognized arguments: --fast"),
    "checkpoint": (("--resume", "none.npz"), "none.npz: there is no such file"),
    "settings": (("--settings", "none.toml"), "cannot read settings from none.toml"),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_bad_options(data, tmp_path, fails, name):
    options, says = OPTIONS[name]
    arguments = ["fit", data / "cell.npy", "--seeds", data / "start.ply", *VOXELS, *SIGMA]
    assert says in fails(*arguments, *options, "-o", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_what_is_not_said(data, tmp_path, fails):
    out = ("-o", tmp_path / "out")
    assert "COMMAND" in fails()
    assert "invalid choice: 'paint'" in fails("paint")
    assert "--output" in fails("fit", data / "cell.tif", "--seeds", data / "start.ply")
    assert "fit needs IMAGE" in fails("fit", "--seeds", data / "start.ply", *out)
    assert "fit needs --seeds" in fails("fit", data / "cell.tif", *out)
    arguments = ("fit", data / "cell.npy", "--seeds", data / "start.ply", *out)
    assert "does not say its voxel size: give --voxel-size" in fails(*arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["report.json", "mesh.rec", "checkpoint.npz", "run.toml"])
def test_nothing_is_written_over(data, tmp_path, run, fails, seen, name):
    (tmp_path / name).write_text("precious")
    arguments = ("fit", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA, "-o", tmp_path)
    assert f"holds {name}; --overwrite" in fails(*arguments)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [(name, "precious")]
    assert run(*arguments, "--overwrite")[0] == 0


def test_folders_that_cannot_be_written(data, tmp_path, fails, monkeypatch):
    monkeypatch.setattr(FIT, None)  # nothing is fitted before this is known
    arguments = ("fit", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA, "-o")
    file = new(tmp_path / "file", "")
    assert "is a file, not a folder" in fails(*arguments, file)
    assert "is a file, not a folder" in fails(*arguments, file / "out")
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert "cannot be written" in fails(*arguments, tmp_path / "out")
    assert list(tmp_path.iterdir()) == [file]


RENDER = {
    "shape": (("--shape", 15, 20, 0), "shape of three positive"),
    "voxel size": (("--voxel-size", 0, 1, 1), "voxel size must be three positive"),
    "sigma": (("--sigma", 0, 1, 1), "sigma must be positive"),
    "accuracy": (("--accuracy", 2), "accuracy must be"),
    "outside": (("--shape", 2, 2, 2, "--voxel-size", 0.01, 0.01, 0.01), "outside the image"),
    "extension": (("-o", "image.jpg"), "unknown image extension '.jpg'"),
    "folder": (("-o", "nowhere/image.tif"), "nowhere does not exist"),
}


@pytest.mark.parametrize("name", RENDER)
def test_bad_render(data, tmp_path, fails, name):
    options, says = RENDER[name]
    path = tmp_path / "image.tif"
    arguments = ("render", data / "start.ply", "--shape", *SHAPE, *VOXELS, *SIGMA, "-o", path)
    assert says in fails(*arguments, *options)
    assert list(tmp_path.iterdir()) == []
