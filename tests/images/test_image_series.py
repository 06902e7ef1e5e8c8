"""Series of stacks: from one file or many, read frame by frame."""

import numpy as np
import pytest
import tifffile

from napari_deltamic.errors import InputError
from napari_deltamic.images.series import open_series
from napari_deltamic.images.stacks import write_image

SIZE = (0.5, 0.2, 0.2)
SERIES = np.arange(3 * 4 * 5 * 6, dtype=np.uint16).reshape(3, 4, 5, 6)


def imagej(path, **options):
    metadata = {"axes": "TZYX", "spacing": 0.5, "unit": "um"}
    tifffile.imwrite(path, SERIES, imagej=True, resolution=(5, 5), metadata=metadata, **options)
    return path


def ome(path, **options):
    metadata = {"axes": "TZYX"}
    for name, side in zip("ZYX", SIZE, strict=True):
        metadata |= {f"PhysicalSize{name}": side, f"PhysicalSize{name}Unit": "µm"}
    tifffile.imwrite(path, SERIES, ome=True, metadata=metadata, **options)
    return path


def plain(path):
    tifffile.imwrite(path, SERIES, photometric="minisblack")
    return path


def npy(path):
    np.save(path, SERIES)
    return path


def files(folder, names):
    folder.mkdir()
    for name, image in zip(names, SERIES, strict=True):
        write_image(folder / name, image, SIZE)
    return folder


MAKE = {
    "ImageJ": (lambda p: imagej(p / "a.tif"), SIZE),
    "OME": (lambda p: ome(p / "a.ome.tif"), SIZE),
    "compressed": (lambda p: ome(p / "a.ome.tif", compression="zlib"), SIZE),
    "LZW": (lambda p: imagej(p / "a.tif", compression="lzw"), SIZE),
    "Zstandard": (lambda p: ome(p / "a.ome.tif", compression="zstd"), SIZE),
    "plain": (lambda p: plain(p / "a.tif"), None),
    "npy": (lambda p: npy(p / "a.npy"), None),
    "folder": (lambda p: files(p / "a", ["t8.tif", "t9.tif", "t10.tif"]), SIZE),
    "pattern": (lambda p: files(p / "a", ["t8.tif", "t9.tif", "t10.tif"]) / "t*.tif", SIZE),
}


@pytest.mark.parametrize("name", MAKE)
def test_every_frame_is_read(name, tmp_path):
    make, size = MAKE[name]
    series = open_series(make(tmp_path))
    assert len(series) == 3
    assert series.shape == SERIES.shape
    assert series.voxel_size == (None if size is None else pytest.approx(size))
    for t in (2, 0, 1):
        np.testing.assert_array_equal(series[t], SERIES[t])
        assert series[t].dtype == np.uint16


def test_only_what_is_asked_for_is_read(tmp_path, monkeypatch):
    series = open_series(imagej(tmp_path / "a.tif"))
    monkeypatch.setattr(tifffile.TiffFile, "asarray", None)
    np.testing.assert_array_equal(series[1], SERIES[1])


def test_a_damaged_file_of_many_is_named_when_it_is_read(tmp_path):
    folder = files(tmp_path / "a", ["t0.tif", "t1.tif", "t2.tif"])
    (folder / "t1.tif").write_bytes(b"no image")
    series = open_series(folder)
    np.testing.assert_array_equal(series[2], SERIES[2])
    with pytest.raises(InputError, match=r"t1\.tif: not a readable image"):
        series[1]


def test_hidden_files_are_no_frames(tmp_path):
    """macOS puts one beside each file, on disks of other systems."""
    folder = files(tmp_path / "a", ["t0.tif", "t1.tif", "t2.tif"])
    for frame in range(3):
        (folder / f"._t{frame}.tif").write_bytes(b"no image")
    assert open_series(folder).names == ["t0.tif", "t1.tif", "t2.tif"]


def small(folder):
    files(folder, ["t0.npy", "t1.npy", "t2.npy"])
    np.save(folder / "t1.npy", SERIES[1, :, :, :4])
    return folder


BAD = {
    "missing": (lambda p: p / "none.tif", "no such file"),
    "extension": (lambda p: npy(p / "a.npy").rename(p / "a.xyz"), "unknown image extension"),
    "empty folder": (lambda p: p, "no .tif"),
    "no match": (lambda p: p / "t*.tif", "no .tif"),
    "damaged": (lambda p: (p / "a.tif").write_bytes(b"x") and p / "a.tif", "not a readable image"),
    "3D": (lambda p: np.save(p / "a.npy", SERIES[0]) or p / "a.npy", "not a single 3D image"),
    "5D": (lambda p: np.save(p / "a.npy", SERIES[None]) or p / "a.npy", "series of 3D stacks"),
    "shapes": (lambda p: small(p / "a"), "all frames must be of one size"),
    "2D": (
        lambda p: (
            tifffile.imwrite(p / "a.tif", SERIES[0], metadata={"axes": "TYX"}, imagej=True)
            or p / "a.tif"
        ),
        "not 2D images over time",
    ),
    "channels": (
        lambda p: (
            tifffile.imwrite(
                p / "a.tif", SERIES.swapaxes(0, 1), metadata={"axes": "ZCYX"}, imagej=True
            )
            or p / "a.tif"
        ),
        "has 3 channels",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_series_is_refused(name, tmp_path):
    make, message = BAD[name]
    path = make(tmp_path)
    with pytest.raises(InputError, match=message) as caught:
        open_series(path)
    assert "\n" not in str(caught.value)
