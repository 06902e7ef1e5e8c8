"""Damaged files are refused in one line, in bounded time and memory."""

import contextlib
import logging
import zipfile

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic import InputError
from napari_deltamic.common.reading import LARGEST_TEXT, json_values, read_text, toml_values
from napari_deltamic.fitting.model.state import load_checkpoint
from napari_deltamic.geometry import read_points_csv, sphere
from napari_deltamic.geometry.archive import ArchiveWriter, opened
from napari_deltamic.geometry.files.vtk import read_vtk
from napari_deltamic.images.stacks import read_image
from napari_deltamic.runs.settings import RunSettings

files = pytest.importorskip("benchmarks.robustness.files")

HEAD = "# vtk DataFile Version 3.0\nx\n{}\nDATASET POLYDATA\n"


def test_spoilt_files_are_read_or_refused():
    found, troubles = files.attempt("reader", 54)  # two of each kind
    assert not troubles
    assert found["refused"] > 25


@pytest.mark.slow
def test_spoilt_files_through_the_command_line():
    found, troubles = files.attempt("command", 6)
    assert not troubles
    assert found["refused"] > 2


@pytest.mark.parametrize(
    "text",
    [
        HEAD.format("BINARY") + "POINTS -9 double\n",
        HEAD.format("BINARY") + "CELL_DATA 1\nFIELD f 1\na 1 -40 double\n",
        HEAD.format("ASCII") + "CELL_DATA 9999999999999\nSCALARS a double 99\n1 2 3\n",
        HEAD.format("ASCII") + "POLYGONS 3 2\n-1 -1\n",
        HEAD.format("ASCII").replace("3.0", "5.1")
        + "POLYGONS 4 3\nOFFSETS vtktypeint64\n0 3 0 3\nCONNECTIVITY vtktypeint64\n0 1 2\n",
    ],
)
def test_counts_that_cannot_be(text):
    with pytest.raises(InputError):
        read_vtk(text.encode())


def test_what_an_archive_may_unpack_to(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "napari_deltamic.geometry.archive._SMALL", 2**22
    )  # 512 MiB would take seconds
    writer = ArchiveWriter()
    writer.add_array("zeros", np.zeros(2**20, np.uint8))  # in 5 KB
    writer.write(tmp_path / "a.zip")

    def read(times):
        with opened(tmp_path / "a.zip", "an archive") as archive:
            return [archive.array("zeros").size for _ in range(times)]

    assert read(1) == [2**20]
    with pytest.raises(InputError, match="unpack to far more"):
        read(5)


def test_long_texts_are_not_read(tmp_path):
    writer = ArchiveWriter()
    writer.add_text("long.json", "[" * (LARGEST_TEXT + 1))
    writer.write(tmp_path / "a.zip")
    with (
        pytest.raises(InputError, match="too long"),
        opened(tmp_path / "a.zip", "an archive") as archive,
    ):
        archive.json("long.json")
    (tmp_path / "long.csv").write_bytes(b"z" * (LARGEST_TEXT + 1))
    with pytest.raises(InputError, match="longer than"):
        read_points_csv(tmp_path / "long.csv")


@pytest.mark.parametrize("read", [toml_values, json_values])
def test_texts_that_are_too_deep(read):
    with pytest.raises(InputError, match="too deep"):
        read(("a = " if read is toml_values else "") + "[" * 100_000)


def test_settings_that_are_no_text(tmp_path):
    path = tmp_path / "run.toml"
    for content in (b"\xff\xfe", b"a = " + b"[" * 100_000, b"a = 1" + b"0" * 10_000):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"cannot read settings from .*run\.toml"):
            RunSettings.from_toml(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_text(tmp_path)


def test_checkpoints_whose_header_is_no_header(tmp_path):
    """NumPy's parser of headers raises tokenize.TokenError on this."""
    bad = b"{'descr': '<f8', 'fortran_order': False, 'shape': (((((3,), }   \n"
    with zipfile.ZipFile(tmp_path / "state.npz", "w") as file:
        header = b"\x93NUMPY\x01\x00" + len(bad).to_bytes(2, "little") + bad
        file.writestr("vertices.npy", header)
    with pytest.raises(InputError, match="not a checkpoint, or a damaged one"):
        load_checkpoint(tmp_path / "state.npz")


def test_libraries_log_nothing(tmp_path, caplog):
    mesh = sphere((0, 0, 0), 1.0, edge_length=0.5)
    path = tmp_path / "mesh.ply"
    nd.save_mesh(mesh, path)
    data = path.read_bytes().replace(b"uchar int vertex_indices", b"uchar int vertex_indicez")
    path.write_bytes(data)
    with caplog.at_level(logging.DEBUG), contextlib.suppress(InputError):
        nd.load_mesh(path)
    assert not [r for r in caplog.records if r.levelno >= logging.WARNING]


def test_a_huge_image_in_a_small_file(tmp_path):
    path = tmp_path / "image.npy"
    np.save(path, np.zeros((2, 3, 4)))
    path.write_bytes(path.read_bytes().replace(b"(2, 3, 4), ", b"(2, 3, 4000000000), ", 1))
    with pytest.raises(InputError, match="not a readable image"):
        read_image(path)
