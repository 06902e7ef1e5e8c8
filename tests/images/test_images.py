"""Image files: what is read, with which voxel size, and what is refused."""

import numpy as np
import pytest
import tifffile

from napari_deltamic.errors import InputError
from napari_deltamic.images.stacks import (
    holds_image,
    read_image,
    read_voxel_size,
    stored_shape,
    write_image,
)

SIZE = (0.3, 0.1, 0.12)
STACK = np.arange(4 * 5 * 6, dtype=np.float32).reshape(4, 5, 6)


def save(path, array=STACK, **options):
    tifffile.imwrite(path, array, **{"photometric": "minisblack", **options})
    return path


def imagej(path, unit, spacing=0.3, resolution=(1 / 0.12, 1 / 0.1)):
    metadata = {"axes": "ZYX", "unit": unit}
    if spacing is not None:
        metadata["spacing"] = spacing
    return save(path, imagej=True, resolution=resolution, metadata=metadata)


def ome(path, unit="µm", array=STACK, axes="ZYX", **sides):
    sides = sides or {"Z": 0.3, "Y": 0.1, "X": 0.12}
    metadata = {"axes": axes}
    for name, value in sides.items():
        metadata[f"PhysicalSize{name}"] = value
        if unit is not None:
            metadata[f"PhysicalSize{name}Unit"] = unit
    return save(path, array, ome=True, metadata=metadata)


@pytest.mark.parametrize("name", ["a.tif", "a.TIFF", "a.ome.tif"])
@pytest.mark.parametrize("kind", ["u1", "u2", "i4", "f4", "f8"])
def test_round_trip(tmp_path, name, kind):
    path = tmp_path / name
    write_image(path, STACK.astype(kind), SIZE)
    image, voxel_size = read_image(path)
    assert image.dtype == np.dtype(kind)
    assert np.array_equal(image, STACK)
    assert voxel_size == pytest.approx(SIZE, rel=1e-6)
    with tifffile.TiffFile(path) as tif:
        assert tif.series[0].axes == "ZYX"
        assert tif.is_ome == ("ome" in name or kind in ("i4", "f8"))
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_what_cellpose_keeps_for_itself_is_refused_with_a_way_out(tmp_path):
    np.save(tmp_path / "a_seg.npy", {"masks": np.zeros((3, 4, 5), np.uint16)})
    with pytest.raises(InputError, match=r"a_seg.npy: it holds Python objects.*save the masks as"):
        read_image(tmp_path / "a_seg.npy")


def test_npy(tmp_path):
    write_image(tmp_path / "a.npy", STACK, SIZE)
    image, voxel_size = read_image(tmp_path / "a.npy")
    assert np.array_equal(image, STACK)
    assert voxel_size is None


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("um", 1), ("micron", 1), ("\\u00B5m", 1), ("nm", 1e-3), ("mm", 1e3), ("nanometres", 1e-3)],
)
def test_imagej_units(tmp_path, unit, factor):
    _, size = read_image(imagej(tmp_path / "a.tif", unit))
    assert size == pytest.approx([factor * d for d in SIZE], rel=1e-6)


def test_imagej_with_a_unit_for_each_axis(tmp_path):
    metadata = {"axes": "ZYX", "unit": "um", "spacing": 300.0, "zunit": "nm"}
    path = save(tmp_path / "a.tif", imagej=True, metadata=metadata, resolution=(10, 1 / 0.12))
    assert read_image(path)[1] == pytest.approx((0.3, 0.12, 0.1))


@pytest.mark.parametrize("unit", ["pixel", "", "furlong", "sec"])
def test_imagej_without_a_unit_of_length(tmp_path, unit):
    assert read_image(imagej(tmp_path / "a.tif", unit))[1] is None


@pytest.mark.parametrize("spacing", [None, 0.0, -0.3, float("nan"), 1e9])
def test_imagej_with_a_spacing_that_cannot_be(tmp_path, spacing):
    assert read_image(imagej(tmp_path / "a.tif", "um", spacing))[1] is None


@pytest.mark.parametrize(
    ("unit", "factor"), [("µm", 1), (None, 1), ("nm", 1e-3), ("mm", 1e3), ("Å", 1e-4)]
)
def test_ome_units(tmp_path, unit, factor):
    path = ome(tmp_path / "a.ome.tif", unit, Z=3.0, Y=1.0, X=2.0)
    assert read_image(path)[1] == pytest.approx([factor * d for d in (3, 1, 2)])


@pytest.mark.parametrize("unit", ["pixel", "reference frame"])
def test_ome_without_a_unit_of_length(tmp_path, unit):
    assert read_image(ome(tmp_path / "a.ome.tif", unit))[1] is None


def test_ome_without_a_side(tmp_path):
    assert read_image(ome(tmp_path / "a.ome.tif", Y=0.1, X=0.1))[1] is None


def test_plain_tiff_has_no_voxel_size(tmp_path):
    image, size = read_image(save(tmp_path / "a.tif", resolution=(300, 300)))
    assert image.shape == STACK.shape
    assert size is None


@pytest.mark.parametrize(
    ("kind", "into", "high"),
    [
        ("float16", "float32", 7),
        ("int64", "uint32", 70000),
        ("uint64", "uint32", 7),
        ("int64", "int32", -7),
        ("int64", "float64", 2**40),
    ],
)
def test_values_that_no_tiff_holds_are_written_as_others(tmp_path, kind, into, high):
    image = np.zeros((2, 3, 4), kind)
    image[1, 2, 3] = high
    write_image(tmp_path / "a.tif", image, SIZE)
    again, size = read_image(tmp_path / "a.tif")
    assert again.dtype == into
    np.testing.assert_array_equal(again, image)
    assert size == pytest.approx(SIZE)


def test_byte_order_and_bool(tmp_path):
    image, _ = read_image(save(tmp_path / "a.tif", STACK.astype(">u2"), byteorder=">"))
    assert image.dtype.isnative
    assert np.array_equal(image, STACK)
    np.save(tmp_path / "b.npy", STACK > 3)
    image, _ = read_image(tmp_path / "b.npy")
    assert image.dtype == np.uint8
    assert image.sum() == (STACK > 3).sum()


def test_axes_of_length_one_are_dropped(tmp_path):
    path = ome(tmp_path / "a.ome.tif", array=STACK[None, :, None], axes="TZCYX", Z=1, Y=1, X=1)
    assert read_image(path)[0].shape == STACK.shape
    np.save(tmp_path / "b.npy", STACK[None, None])
    assert read_image(tmp_path / "b.npy")[0].shape == STACK.shape


def damaged(path):
    data = save(path.with_suffix(".tiff")).read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


def garbage(path, content=b"this is no image at all"):
    path.write_bytes(content)
    return path


def npy(path, array):
    np.save(path.with_suffix(".npy"), array, allow_pickle=True)
    return path.with_suffix(".npy")


BAD = {
    "missing": (lambda p: p, "no such file"),
    "folder": (lambda p: p.mkdir() or p, "not a readable image"),
    "extension": (lambda p: garbage(p.with_suffix(".jpg")), r"extension '\.jpg'; known are \.tif"),
    "empty file": (lambda p: garbage(p, b""), "the file is empty"),
    "garbage": (garbage, "not a readable image"),
    "damaged": (damaged, "not a readable image|the file holds no image"),
    "2D": (lambda p: save(p, STACK[0]), r"a 2D image \(shape \(5, 6\), axes YX\)"),
    "colours": (
        lambda p: save(p, np.zeros((4, 5, 6, 3), np.uint8), photometric="rgb"),
        r"has 3 channels \(1 red, 2 green, 3 blue\).*\(4, 5, 6, 3\)",
    ),
    "channels": (
        lambda p: ome(p, array=np.zeros((2, 4, 5, 6), np.uint8), axes="CZYX", Z=1, Y=1, X=1),
        r"has 2 channels \(1 to 2\): save one of them alone.*\(2, 4, 5, 6\), axes CZYX",
    ),
    "time": (
        lambda p: save(p, STACK, imagej=True, metadata={"axes": "TYX"}),
        r"several time points.*axes TYX",
    ),
    "5D": (lambda p: npy(p, np.zeros((2, 2, 3, 4, 5))), "an image of 5 dimensions"),
    "no voxels": (lambda p: npy(p, np.zeros((0, 4, 5))), r"empty: its shape is \(0, 4, 5\)"),
    "complex": (lambda p: npy(p, STACK * 1j), "complex"),
    "words": (lambda p: npy(p, np.full((2, 2, 2), "a")), "real numbers"),
    "objects": (lambda p: npy(p, np.full((2, 2, 2), None)), "it holds Python objects"),
}


@pytest.mark.parametrize("name", BAD)
def test_refused(tmp_path, name, capfd):
    make, message = BAD[name]
    path = make(tmp_path / "a.tif")
    with pytest.raises(InputError, match=message) as caught:
        read_image(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("name", "image", "size"),
    [
        ("a.png", STACK, SIZE),
        ("a.tif", STACK[0], SIZE),
        ("a.tif", STACK * 1j, SIZE),
        ("a.tif", STACK, (0.1, 0.0, 0.1)),
        ("a.tif", STACK, (0.1, 0.1, float("nan"))),
        ("nowhere/a.tif", STACK, SIZE),
    ],
)
def test_not_written(tmp_path, name, image, size):
    with pytest.raises(InputError):
        write_image(tmp_path / name, image, size)
    assert list(tmp_path.iterdir()) == []


# ---- whether a file still is what is shown -------------------------------------------------------


@pytest.mark.parametrize("name", ["a.tif", "a.ome.tif", "a.npy"])
def test_a_file_holds_what_was_written_and_nothing_else(tmp_path, name):
    image = np.random.default_rng(0).random((4, 5, 6)).astype(np.float32)
    image[1, 2, 3] = np.nan
    path = tmp_path / name
    write_image(path, image, (1, 1, 1))
    assert stored_shape(path) == (4, 5, 6)
    assert holds_image(path, image)
    assert holds_image(path, np.where(np.isnan(image), np.inf, image))
    edited = image.copy()
    edited[3, 4, 5] += 1
    assert not holds_image(path, edited)
    assert not holds_image(path, np.nan_to_num(image))
    assert not holds_image(path, image[:, :, :5])
    path.unlink()
    assert not holds_image(path, image)
    assert stored_shape(path) is None


def test_channels_and_time_points_are_not_the_file(tmp_path):
    series = np.arange(2 * 4 * 5 * 6, dtype=np.uint16).reshape(2, 4, 5, 6)
    tifffile.imwrite(tmp_path / "t.tif", series, imagej=True, metadata={"axes": "TZYX"})
    assert not holds_image(tmp_path / "t.tif", series[0])
    assert stored_shape(tmp_path / "t.tif") == (2, 4, 5, 6)
    one = tmp_path / "one.tif"
    tifffile.imwrite(one, series[:1], imagej=True, metadata={"axes": "TZYX"})
    assert holds_image(one, series[0])


# ---- the voxel size alone ------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["u1", "u2", "i4", ">f4", "f8"])
@pytest.mark.parametrize("name", ["a.tif", "a.ome.tif", "a.npy"])
def test_the_voxel_size_is_that_of_the_image(tmp_path, name, kind):
    path = tmp_path / name
    write_image(path, STACK.astype(kind), SIZE)
    assert read_voxel_size(path) == read_image(path)[1]
    assert (read_voxel_size(path) is None) == (name == "a.npy")


def test_the_voxel_size_of_files_that_do_not_say(tmp_path):
    assert read_voxel_size(save(tmp_path / "plain.tif")) is None
    assert read_voxel_size(imagej(tmp_path / "pixel.tif", "pixel")) is None


def test_the_voxel_size_needs_no_pixels(tmp_path, monkeypatch):
    path = tmp_path / "a.tif"
    write_image(path, STACK, SIZE)

    def fail(*args, **options):
        raise AssertionError("the pixels were read")

    monkeypatch.setattr(tifffile.TiffPageSeries, "asarray", fail)
    assert read_voxel_size(path) == pytest.approx(SIZE)


@pytest.mark.parametrize("name", [name for name in BAD if name != "damaged"])
def test_no_voxel_size_of_what_is_no_stack(tmp_path, name, capfd):
    make, message = BAD[name]
    path = make(tmp_path / "a.tif")
    with pytest.raises(InputError, match=message):
        read_voxel_size(path)
    assert capfd.readouterr() == ("", "")
