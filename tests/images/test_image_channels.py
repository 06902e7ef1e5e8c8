"""One channel of several: of every kind of file, by number and by name, and what is refused."""

import numpy as np
import pytest
import tifffile

from napari_deltamic.errors import InputError
from napari_deltamic.images.channels import channel_axis
from napari_deltamic.images.series import open_series
from napari_deltamic.images.stacks import (
    holds_image,
    read_image,
    read_voxel_size,
    stored_shape,
    write_image,
)
from napari_deltamic.images.stored import open_stored

SIZE = (0.5, 0.2, 0.2)
NAMES = ("DAPI", "membrane", "GFP")
# (T, C, Z, Y, X), no two values alike.
ALL = np.arange(2 * 3 * 4 * 5 * 6, dtype=np.uint16).reshape(2, 3, 4, 5, 6)
STACK = ALL[0]


def ordered(axes):
    """The voxels in this order of axes; without T, of the first time."""
    array = ALL if "T" in axes else STACK
    known = "TCZYX" if "T" in axes else "CZYX"
    return np.transpose(array, [known.index(a) for a in axes])


def imagej(path, axes="ZCYX", **options):
    metadata = {"axes": axes, "spacing": 0.5, "unit": "um"}
    if axes == "ZCYX":
        # As Fiji and Bio-Formats label planes: channels first, then slices.
        metadata["Labels"] = [f"c:{c + 1}/3 z:{z + 1}/4 - {n}" for z in range(4) for c, n in NAMED]
    else:
        metadata["Labels"] = list(NAMES)
    # ImageJ knows one order of planes only.
    array = ordered("TZCYX" if "T" in axes else "ZCYX")
    metadata["axes"] = "TZCYX" if "T" in axes else "ZCYX"
    tifffile.imwrite(path, array, imagej=True, resolution=(5, 5), metadata=metadata, **options)
    return path


NAMED = list(enumerate(NAMES))


def ome(path, axes="CZYX", names=NAMES, **options):
    metadata = {"axes": axes} | ({"Channel": {"Name": list(names)}} if names else {})
    for name, side in zip("ZYX", SIZE, strict=True):
        metadata |= {f"PhysicalSize{name}": side, f"PhysicalSize{name}Unit": "µm"}
    tifffile.imwrite(
        path, ordered(axes), ome=True, photometric="minisblack", metadata=metadata, **options
    )
    return path


def plain(path, axes="CZYX", **options):
    tifffile.imwrite(
        path, ordered(axes), photometric="minisblack", metadata={"axes": axes}, **options
    )
    return path


def zarr_image(path, axes="czyx", labels=NAMES):
    zarr = pytest.importorskip("zarr")
    scale = [{"t": 1.0, "c": 1.0, "z": 0.5, "y": 0.2, "x": 0.2}[a] for a in axes]
    kinds = {"t": "time", "c": "channel"}
    facts = {
        "version": "0.4",
        "axes": [
            {"name": a, "type": kinds[a]}
            if a in kinds
            else {"name": a, "type": "space", "unit": "micrometer"}
            for a in axes
        ],
        "datasets": [
            {"path": "0", "coordinateTransformations": [{"type": "scale", "scale": scale}]}
        ],
    }
    omero = {"channels": [{"label": label} for label in labels]}
    attributes = {"multiscales": [facts], "omero": omero}
    group = zarr.open_group(str(path), mode="w", zarr_format=2, attributes=attributes)
    group.create_array("0", data=ordered(axes.upper()))
    return path


def colours(path, **options):
    array = np.moveaxis(STACK, 0, -1).astype(np.uint8)
    tifffile.imwrite(path, array, photometric="rgb", **options)
    return path


# File, its names, its voxel size.
MAKE = {
    "ImageJ": (lambda p: imagej(p / "a.tif"), NAMES, SIZE),
    "OME CZYX": (lambda p: ome(p / "a.ome.tif"), NAMES, SIZE),
    "OME ZCYX": (lambda p: ome(p / "a.ome.tif", "ZCYX"), NAMES, SIZE),
    "OME packed": (lambda p: ome(p / "a.ome.tif", compression="zlib"), NAMES, SIZE),
    "OME ZCYX packed": (lambda p: ome(p / "a.ome.tif", "ZCYX", compression="zlib"), NAMES, SIZE),
    "OME no names": (lambda p: ome(p / "a.ome.tif", names=()), (), SIZE),
    "plain CZYX": (lambda p: plain(p / "a.tif"), (), None),
    "plain ZCYX packed": (lambda p: plain(p / "a.tif", "ZCYX", compression="zlib"), (), None),
    "plain ZYXC": (lambda p: plain(p / "a.tif", "ZYXC"), (), None),
    "OME-Zarr": (lambda p: zarr_image(p / "a.zarr"), NAMES, SIZE),
    "OME-Zarr no names": (lambda p: zarr_image(p / "a.zarr", labels=()), (), SIZE),
}


@pytest.mark.parametrize("name", MAKE)
def test_each_channel_of_each_file(name, tmp_path):
    make, names, size = MAKE[name]
    path = make(tmp_path)
    stored = open_stored(path)
    assert stored.channels == names
    assert stored.shape[channel_axis(stored)] == 3
    for k in range(3):
        for asked in [str(k + 1), *names[k : k + 1], *[n.upper() for n in names[k : k + 1]]]:
            image, found = read_image(path, asked)
            np.testing.assert_array_equal(image, STACK[k])
            assert image.dtype == np.uint16
            assert found == (None if size is None else pytest.approx(size))
            assert read_voxel_size(path, asked) == found
        assert stored_shape(path, str(k + 1)) == STACK.shape[1:]
        assert holds_image(path, STACK[k], str(k + 1))
        assert not holds_image(path, STACK[k], str((k + 1) % 3 + 1))
    assert stored_shape(path) is None
    with pytest.raises(InputError) as caught:
        read_image(path, flag="--channel")
    listed = "(1 DAPI, 2 membrane, 3 GFP)" if names else "(1 to 3)"
    assert f"{path}: the image has 3 channels {listed}: choose one with --channel (shape" in str(
        caught.value
    )
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("packed", [False, True])
def test_colours_are_channels(tmp_path, packed):
    path = colours(tmp_path / "a.tif", compression="zlib" if packed else None)
    for k, name in enumerate(("red", "green", "blue")):
        np.testing.assert_array_equal(read_image(path, name)[0], STACK[k].astype(np.uint8))
    with pytest.raises(InputError, match=r"3 channels \(1 red, 2 green, 3 blue\)"):
        read_image(path)


SERIES = {
    "ImageJ": lambda p: imagej(p / "a.tif", "TZCYX"),
    "ImageJ packed": lambda p: imagej(p / "a.tif", "TZCYX", compression="zlib"),
    "OME TCZYX": lambda p: ome(p / "a.ome.tif", "TCZYX"),
    "OME TZCYX": lambda p: ome(p / "a.ome.tif", "TZCYX"),
    "OME CTZYX": lambda p: ome(p / "a.ome.tif", "CTZYX"),
    "OME packed": lambda p: ome(p / "a.ome.tif", "TCZYX", compression="zlib"),
    "OME-Zarr": lambda p: zarr_image(p / "a.zarr", "tczyx"),
}


@pytest.mark.parametrize("name", SERIES)
def test_each_channel_of_each_series(name, tmp_path):
    path = SERIES[name](tmp_path)
    for k, channel in enumerate(NAMES):
        series = open_series(path, channel)
        assert series.shape == (2, 4, 5, 6)
        assert series.voxel_size == pytest.approx(SIZE)
        for t in (1, 0):
            np.testing.assert_array_equal(series[t], ALL[t, k])
    with pytest.raises(InputError, match=r"3 channels \(1 DAPI.*: choose one with --channel"):
        open_series(path, flag="--channel")
    with pytest.raises(InputError, match="several time points"):
        read_image(path, "1")


def test_a_series_of_files_with_channels(tmp_path):
    folder = tmp_path / "movie"
    folder.mkdir()
    for t in range(2):
        tifffile.imwrite(
            folder / f"t{t}.tif",
            ALL[t],
            photometric="minisblack",
            ome=True,
            metadata={"axes": "CZYX", "Channel": {"Name": list(NAMES)}},
        )
    series = open_series(folder, "GFP")
    assert series.shape == (2, 4, 5, 6)
    np.testing.assert_array_equal(series[1], ALL[1, 2])
    with pytest.raises(InputError, match=r"t0\.tif: the image has 3 channels"):
        open_series(folder)
    with pytest.raises(InputError, match=r"t0\.tif: there is no channel '4'"):
        open_series(folder, "4")


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_other_channels_are_not_read(tmp_path, monkeypatch, compression):
    path = ome(tmp_path / "a.ome.tif", compression=compression)
    read = []
    whole = tifffile.TiffPageSeries.asarray
    monkeypatch.setattr(
        tifffile.TiffPageSeries, "asarray", lambda *a, **o: read.append(1) or whole(*a, **o)
    )
    np.testing.assert_array_equal(read_image(path, "2")[0], STACK[1])
    assert not read


BAD = {
    "number 0": ("0", "there is no channel '0': the image has 3 channels (1 DAPI"),
    "number 5": ("5", "there is no channel '5': the image has 3 channels (1 DAPI"),
    "unknown name": ("actin", "there is no channel 'actin': the image has 3 channels (1 DAPI"),
    "nothing": ("", "there is no channel ''"),
}


@pytest.mark.parametrize("name", BAD)
def test_channels_that_are_not_there(name, tmp_path):
    channel, says = BAD[name]
    with pytest.raises(InputError) as caught:
        read_image(ome(tmp_path / "a.ome.tif"), channel, "--channel")
    assert says in str(caught.value)


def test_a_single_channel(tmp_path):
    path = tmp_path / "a.tif"
    write_image(path, STACK[0], SIZE)
    np.testing.assert_array_equal(read_image(path, "1")[0], STACK[0])
    for channel in ("2", "membrane"):
        with pytest.raises(InputError, match="the image has one only: leave out --channel"):
            read_image(path, channel, "--channel")
    named = tmp_path / "b.ome.tif"
    tifffile.imwrite(
        named, STACK[:1], ome=True, metadata={"axes": "CZYX", "Channel": {"Name": ["actin"]}}
    )
    np.testing.assert_array_equal(read_image(named, "actin")[0], STACK[0])
    np.testing.assert_array_equal(read_image(named)[0], STACK[0])


def test_axes_without_names_are_no_channels(tmp_path):
    np.save(tmp_path / "a.npy", STACK)
    tifffile.imwrite(tmp_path / "a.tif", STACK, photometric="minisblack")
    for path in (tmp_path / "a.npy", tmp_path / "a.tif"):
        with pytest.raises(InputError, match="does not say which of its axes are channels"):
            read_image(path, "1", "--channel")
        with pytest.raises(InputError, match="an image of 4 dimensions"):
            read_image(path)


@pytest.mark.parametrize("channel", [None, "1"])
def test_flat_images_of_several_channels(tmp_path, channel):
    tifffile.imwrite(tmp_path / "a.tif", STACK[:, 0], imagej=True, metadata={"axes": "CYX"})
    tifffile.imwrite(tmp_path / "b.tif", np.zeros((7, 8, 3), np.uint8), photometric="rgb")
    for name in ("a.tif", "b.tif"):
        with pytest.raises(InputError, match=r"not a 2D image of 3 channels .* as slices"):
            read_image(tmp_path / name, channel, "--channel")


def test_names_that_are_numbers_or_twice_there(tmp_path):
    """Numbers prevail; wavelengths are names; of two alike the number decides."""
    path = ome(tmp_path / "a.ome.tif", names=("488", "3", "488"))
    with pytest.raises(InputError, match="2 channels are called '488': give the number of one"):
        read_image(path, "488")
    np.testing.assert_array_equal(read_image(path, "3")[0], STACK[2])
    path = ome(tmp_path / "b.ome.tif", names=("405", "488", "gfp"))
    np.testing.assert_array_equal(read_image(path, "488")[0], STACK[1])
    path = ome(tmp_path / "c.ome.tif", names=("GFP", "gfp", ""))
    np.testing.assert_array_equal(read_image(path, "gfp")[0], STACK[1])
    with pytest.raises(InputError, match=r"\(1 GFP, 2 gfp, 3\)"):
        read_image(path)


def test_labels_of_single_planes_are_no_names(tmp_path):
    """Files of a folder, opened as a hyperstack, leave their names as labels."""
    labels = [f"scan{k:03}.tif" for k in range(12)]
    metadata = {"axes": "ZCYX", "Labels": labels}
    tifffile.imwrite(tmp_path / "a.tif", ordered("ZCYX"), imagej=True, metadata=metadata)
    assert open_stored(tmp_path / "a.tif").channels == ()
