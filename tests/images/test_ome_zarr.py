"""OME-Zarr and arrays that are read lazily: what goes in comes out, and what cannot be is said."""

import sys

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import sphere
from napari_deltamic.images.series import open_series
from napari_deltamic.images.stacks import (
    holds_image,
    read_image,
    read_voxel_size,
    stored_shape,
    write_image,
)

zarr = pytest.importorskip("zarr")
SIZE = (0.3, 0.2, 0.1)


def store(path, array, axes="zyx", unit="micrometer", version="0.5", scale=None, whole=None):
    """An image as other programs write it."""
    kinds = {"t": "time", "c": "channel"}
    named = [{"name": a, "type": kinds.get(a, "space")} for a in axes]
    for axis in named:
        if axis["type"] == "space" and unit:
            axis["unit"] = unit
    scale = [SIZE["zyx".index(a)] if a in "zyx" else 1.0 for a in axes] if scale is None else scale
    image = {
        "axes": named,
        "datasets": [
            {"path": "0", "coordinateTransformations": [{"type": "scale", "scale": scale}]},
            {"path": "1", "coordinateTransformations": [{"type": "scale", "scale": scale}]},
        ],
    }
    if whole is not None:
        image["coordinateTransformations"] = [{"type": "scale", "scale": whole}]
    facts = {"version": version, "multiscales": [image]}
    attributes = {"ome": facts} if version == "0.5" else facts
    group = zarr.open_group(str(path), mode="w", attributes=attributes,
                            zarr_format=3 if version == "0.5" else 2)  # fmt: skip
    group.create_array("0", data=array)
    return path


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32", "int32", "float32", "float64"])
def test_a_stack_comes_back_to_the_last_bit(tmp_path, dtype):
    image = (np.random.default_rng(0).random((7, 70, 9)) * 200).astype(dtype)
    path = tmp_path / "stack.ome.zarr"
    write_image(path, image, SIZE)
    again, size = read_image(path)
    assert again.dtype == image.dtype
    np.testing.assert_array_equal(again, image)
    assert size == SIZE
    assert read_voxel_size(path) == SIZE
    assert stored_shape(path) == image.shape
    assert holds_image(path, image)
    assert not holds_image(path, image + 1)
    assert [p.name for p in tmp_path.iterdir()] == ["stack.ome.zarr"]


@pytest.mark.parametrize("axes", ["xyz", "yxz", "zxy", "cxyz", "xyzc"])
def test_axes_of_space_in_any_order(tmp_path, axes):
    image = np.arange(2 * 3 * 4 * 5, dtype=np.uint16).reshape(2, 3, 4, 5)  # C Z Y X
    several = "c" in axes
    stored = (image if several else image[1]).transpose(
        ["czyx"[not several :].index(a) for a in axes]
    )
    path = store(tmp_path / "a.zarr", stored, axes=axes)
    again, size = read_image(path, "2" if several else None)
    np.testing.assert_array_equal(again, image[1])
    assert size == SIZE
    frames = np.stack([stored, stored + 7])
    path = store(tmp_path / "t.zarr", frames, axes="t" + axes)
    series = open_series(path, "2" if several else None)
    np.testing.assert_array_equal(series[1], image[1] + 7)


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_a_folder_of_bioformats2raw(tmp_path, version):
    """It holds a folder for each image."""
    image = np.arange(3 * 4 * 5, dtype=np.uint16).reshape(3, 4, 5)
    facts = {"bioformats2raw.layout": 3}
    zarr.open_group(
        str(tmp_path / "a.zarr"), mode="w", zarr_format=3 if version == "0.5" else 2,
        attributes={"ome": facts} if version == "0.5" else facts,
    )  # fmt: skip
    store(tmp_path / "a.zarr" / "0", image[None, None], axes="tczyx", version=version)
    again, size = read_image(tmp_path / "a.zarr")
    np.testing.assert_array_equal(again, image)
    assert size == SIZE


def test_where_the_first_voxel_lies_is_said(tmp_path):
    write_image(tmp_path / "a.zarr", np.ones((3, 4, 5), np.uint8), SIZE, (-1.0, 2.0, 0.5))
    (image,) = zarr.open_group(str(tmp_path / "a.zarr")).attrs["multiscales"]
    scale, move = image["datasets"][0]["coordinateTransformations"]
    assert scale == {"type": "scale", "scale": list(SIZE)}
    assert move == {"type": "translation", "translation": [-1.0, 2.0, 0.5]}
    assert read_voxel_size(tmp_path / "a.zarr") == SIZE


def test_what_is_missing_stays_missing(tmp_path):
    image = np.ones((3, 4, 5), np.float32)
    image[1, 2, 3] = np.nan
    write_image(tmp_path / "a.zarr", image, SIZE)
    np.testing.assert_array_equal(read_image(tmp_path / "a.zarr")[0], image)


def test_an_older_one_is_replaced(tmp_path):
    for value in (1, 2):
        write_image(tmp_path / "a.zarr", np.full((3, 4, 5), value, np.uint8), SIZE)
    assert read_image(tmp_path / "a.zarr")[0].max() == 2


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["rendered", "labels"])
def test_it_is_valid(tmp_path, name):
    models = pytest.importorskip("ome_zarr_models")
    write_image(tmp_path / f"{name}.ome.zarr", np.ones((3, 4, 5), np.uint16), SIZE)
    group = zarr.open_group(str(tmp_path / f"{name}.ome.zarr"), mode="r")
    assert models.open_ome_zarr(group).ome_zarr_version == "0.4"


@pytest.mark.parametrize("version", ["0.4", "0.5"])
@pytest.mark.parametrize(("axes", "lead"), [("zyx", ()), ("czyx", (1,)), ("tczyx", (1, 1))])
def test_axes_of_length_one_are_left_out(tmp_path, version, axes, lead):
    image = np.random.default_rng(0).random((3, 4, 5))
    path = store(tmp_path / "a.zarr", image.reshape(*lead, 3, 4, 5), axes, version=version)
    again, size = read_image(path)
    np.testing.assert_array_equal(again, image)
    assert size == SIZE


def test_units_and_scales(tmp_path):
    image = np.ones((3, 4, 5), np.uint8)
    assert read_voxel_size(
        store(tmp_path / "a.zarr", image, unit="nanometer", scale=[300, 200, 100])
    ) == (pytest.approx(SIZE))
    assert read_voxel_size(store(tmp_path / "b.zarr", image, whole=[2, 2, 2])) == (0.6, 0.4, 0.2)
    for name, unit in (("c", ""), ("d", "parsec")):
        assert read_voxel_size(store(tmp_path / f"{name}.zarr", image, unit=unit)) is None


@pytest.mark.parametrize(("axes", "lead"), [("tzyx", ()), ("tczyx", (1,))])
def test_only_the_frame_asked_for_is_read(tmp_path, monkeypatch, axes, lead):
    frames = np.random.default_rng(0).random((3, 4, 5, 6)).astype(np.float32)
    path = store(tmp_path / "a.zarr", frames.reshape(3, *lead, 4, 5, 6), axes)
    series = open_series(path)
    assert series.shape == frames.shape
    assert series.voxel_size == SIZE
    read = []
    plain = zarr.Array.__getitem__
    monkeypatch.setattr(zarr.Array, "__getitem__", lambda a, key: read.append(key) or plain(a, key))
    np.testing.assert_array_equal(series[1], frames[1])
    every = slice(None)
    assert read == [(1, *([0] if lead else []), every, every, every)]


BAD = {
    "channels": (lambda p: store(p, np.ones((2, 3, 4, 5)), "czyx"), "has 2 channels"),
    "times": (lambda p: store(p, np.ones((2, 3, 4, 5)), "tzyx"), "several time points"),
    "flat": (lambda p: store(p, np.ones((4, 5)), "yx"), "a 2D image"),
    "no image": (lambda p: zarr.open_group(str(p), mode="w"), "no multiscales"),
    "empty": (lambda p: p.mkdir(), "no OME-Zarr image"),
    "a file": (lambda p: p.write_text("x"), "no OME-Zarr image"),
    "missing": (lambda p: None, "there is no such file"),
    "axes": (lambda p: store(p, np.ones((3, 4, 5)), "tzyx"), "names 4 axes of 3"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_read(tmp_path, name):
    make, says = BAD[name]
    path = tmp_path / "a.zarr"
    make(path)
    for read in (read_image, read_voxel_size):
        with pytest.raises(InputError, match=says) as caught:
            read(path)
        assert "a.zarr" in str(caught.value)
        assert "\n" not in str(caught.value)


def test_without_the_package_it_is_said(tmp_path, monkeypatch):
    (tmp_path / "a.zarr").mkdir()
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(InputError, match=r"napari-deltamic\[many\]"):
        read_image(tmp_path / "a.zarr")
    with pytest.raises(InputError, match=r"napari-deltamic\[many\]"):
        write_image(tmp_path / "b.zarr", np.ones((3, 4, 5), np.uint8), SIZE)


def test_a_full_disk_leaves_the_older_image(tmp_path, monkeypatch):
    path = tmp_path / "a.zarr"
    write_image(path, np.ones((3, 4, 5), np.uint8), SIZE)

    def full(*told, **more):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zarr.Array, "__setitem__", full)
    with pytest.raises(InputError, match="No space left"):
        write_image(path, np.zeros((3, 4, 5), np.uint8), SIZE)
    assert read_image(path)[0].max() == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]


@pytest.mark.parametrize("kind", ["dask", "zarr"])
def test_lazy_arrays_are_fitted_like_others(tmp_path, kind):
    dask = pytest.importorskip("dask.array")
    grid = nd.Grid((14, 16, 16), (0.3, 0.3, 0.3))
    optics = nd.GaussianPSF((0.4,) * 3)
    start = sphere((2.0, 2.2, 2.2), 1.0, edge_length=0.6)
    image = nd.render(sphere((2.0, 2.2, 2.2), 1.2, edge_length=0.4), grid, optics).numpy()
    lazy = dask.from_array(image, (7, 8, 8))
    if kind == "zarr":
        lazy = zarr.create_array(str(tmp_path / "a"), data=image)
    ends = []
    for given in (image, lazy):
        states = nd.fit(given, grid, start, optics)
        ends.append(next(iter(states)))
    np.testing.assert_array_equal(ends[0].mesh.vertices, ends[1].mesh.vertices)


def test_a_bare_array_is_refused_in_words(tmp_path):
    zarr.create_array(str(tmp_path / "a.zarr"), data=np.ones((3, 4, 5), np.uint16))
    for read in (read_image, read_voxel_size):
        with pytest.raises(InputError, match="a bare Zarr array, which says neither axes nor"):
            read(tmp_path / "a.zarr")
