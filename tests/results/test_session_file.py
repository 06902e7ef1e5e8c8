"""A session file gives back what was saved, and refuses what is no such file, in one line."""

import errno
import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import files, sphere
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.results.report import History
from napari_deltamic.results.session_file import (
    SavedImage,
    SavedLayer,
    SavedResult,
    SavedTracks,
    Session,
    load_session,
    save_session,
)
from napari_deltamic.results.timeline import Moment
from napari_deltamic.runs.optics_settings import MeasuredOptics
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.runs.track_run import TrackRun
from napari_deltamic.scene.effects import Effects, Halo
from napari_deltamic.tracking import FrameResult, TrackSettings

SHAPE, SIZE = (6, 7, 8), (0.3, 0.1, 0.2)
PLACE = {"scale": (300.0, 100.0, 200.0), "translate": (1.5, 0.0, -2.0), "units": ("nanometer",) * 3}


def settings(**fit):
    return RunSettings(
        image="", seeds="", scene=SceneSettings(voxel_size=SIZE), fit=FitSettings(**fit)
    )


def two_cells():
    parts = [sphere((0.8, 0.3, x), 0.2, edge_length=0.2) for x in (0.4, 1.0)]
    return nd.Mesh.merge(parts)


def session(dtype=np.float32):
    rng = np.random.default_rng(0)
    pixels = (100 * rng.random(SHAPE)).astype(dtype)
    if np.issubdtype(dtype, np.floating):
        pixels[1, 2, 3] = np.nan
    mesh = two_cells()
    moved = [mesh.with_vertices(mesh.vertices_numpy() + 1e-3 * k / 3) for k in range(4)]
    optics = nd.GaussianPSF((0.1 + 0.2, 1 / 3, 0.7))
    state = nd.FitState(
        iteration=12,
        level=2,
        levels=3,
        mesh=moved[3],
        optics=optics,
        density=rng.random(len(mesh.faces)),
        loss=1 / 3,
        amplitude=np.pi,
        background=-2 / 7,
        blur=1.35,
        converged=True,
        message="converged",
        effects=Effects.of(Halo(fraction=1 / 3), "pixel_integration"),
    )
    result = SavedResult(
        settings=settings(density="smooth", levels=(2.0, 1.0)),
        state=state,
        history=History([0.9, 2 / 3, 1 / 3], [1, 1, 2], [2.0, 2.0, 1.0], first=10),
        seconds=1.25,
        verdict="converged",
        message="converged (12 iterations)",
        start=mesh,
        counted=rng.random(SHAPE) < 0.5,
        moments=tuple(
            Moment(
                iteration=k,
                loss=1 / (k + 3) if k else np.nan,
                mesh=moved[k],
                optics=optics,
                note=f"note {k}",
            )
            for k in range(3)
        ),
    )
    points = SavedLayer(
        "points", "zweite Höhle", {"data": rng.random((2, 3)), "size": rng.random(2)}, **PLACE
    )
    labels = SavedLayer("labels", "l", {"data": rng.integers(0, 9, SHAPE, np.uint8)}, **PLACE)
    display = {"contrast_limits": [0.1, 99.5], "colormap": {"name": "gray"}}
    return Session(
        settings=settings(accuracy=3e-3),
        image=SavedImage("cells", pixels, SIZE, display=display, **PLACE),
        seeds=(points, labels),
        result=result,
        panels={"start as": "sphere", "radius": 0.1},
    )


def same(a, b):
    """Bit for bit, not a number included."""
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def same_mesh(a, b):
    return (
        same(a.vertices_numpy(), b.vertices_numpy())
        and same(a.faces, b.faces)
        and same(a.regions, b.regions)
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.float32, np.float64, ">u2"])
def test_what_was_saved_is_what_is_reopened(tmp_path, dtype):
    before = session(np.dtype(dtype).type if dtype != ">u2" else np.dtype(dtype))
    save_session(tmp_path / "a.deltamic", before)
    after = load_session(tmp_path / "a.deltamic")
    assert after.settings == before.settings
    assert after.panels == before.panels
    assert same(after.image.pixels, before.image.pixels)
    for name in ("name", "voxel_size", "scale", "translate", "units", "display"):
        assert getattr(after.image, name) == getattr(before.image, name)
    for a, b in zip(after.seeds, before.seeds, strict=True):
        assert (a.kind, a.name, a.scale, a.units) == (b.kind, b.name, b.scale, b.units)
        assert a.arrays.keys() == b.arrays.keys()
        assert all(same(a.arrays[key], b.arrays[key]) for key in a.arrays)
    a, b = after.result, before.result
    for name in ("settings", "history", "seconds", "verdict", "message"):
        assert getattr(a, name) == getattr(b, name)
    scalars = ("iteration", "loss", "amplitude", "background", "blur", "converged", "message")
    for name in (*scalars, "effects"):
        assert getattr(a.state, name) == getattr(b.state, name)
    assert same(a.state.density, b.state.density)
    assert same_mesh(a.state.mesh, b.state.mesh)
    assert same_mesh(a.start, b.start)
    assert same(a.counted, b.counted)
    assert a.state.optics.sigma_um == b.state.optics.sigma_um
    assert len(a.moments) == 3
    for new, old in zip(a.moments, b.moments, strict=True):
        assert (new.iteration, new.note) == (old.iteration, old.note)
        assert same(np.array(new.loss), np.array(old.loss))
        assert same_mesh(new.mesh, old.mesh)
        assert new.optics.sigma_um == old.optics.sigma_um


def test_a_session_without_a_result(tmp_path):
    save_session(tmp_path / "a.deltamic", replace(session(), result=None, seeds=()))
    after = load_session(tmp_path / "a.deltamic")
    assert after.result is None
    assert after.seeds == ()


def test_a_reopened_state_renders_as_before(tmp_path):
    before = session()
    save_session(tmp_path / "a.deltamic", before)
    state = load_session(tmp_path / "a.deltamic").result.state
    clean = nd.render(
        before.result.state.mesh,
        nd.Grid(SHAPE, SIZE),
        before.result.state.optics,
        density=before.result.state.density,
        effects=before.result.state.effects,
    ).numpy()
    expected = np.pi * clean - 2 / 7
    np.testing.assert_allclose(state.rendered(), expected, rtol=1e-5, atol=1e-6)


def test_faces_that_meshes_share_are_stored_once_and_shared_again(tmp_path):
    path = tmp_path / "a.deltamic"
    save_session(path, session())
    with zipfile.ZipFile(path) as file:
        assert sum(name.startswith("faces/") for name in file.namelist()) == 2
    result = load_session(path).result
    assert result.moments[0].mesh.faces is result.state.mesh.faces


def test_arrays_can_be_read_by_numpy_alone(tmp_path):
    before = session()
    save_session(tmp_path / "a.deltamic", before)
    with np.load(tmp_path / "a.deltamic", allow_pickle=False) as file:
        np.testing.assert_array_equal(file["image"], before.image.pixels)


def test_pictures_that_lie_anyhow_in_memory(tmp_path):
    for pixels in (
        np.asfortranarray(session().image.pixels),
        np.arange(2 * 6 * 7 * 8.0).reshape(2, 6, 7, 8)[:, ::-1, :, ::2][1],
    ):
        before = session()
        save_session(
            tmp_path / "a.deltamic", replace(before, image=replace(before.image, pixels=pixels))
        )
        after = load_session(tmp_path / "a.deltamic").image.pixels
        np.testing.assert_array_equal(after, pixels)
        assert after.dtype == pixels.dtype


def test_python_objects_are_not_saved(tmp_path):
    before = session()
    odd = replace(before, image=replace(before.image, pixels=np.full(SHAPE, None)))
    with pytest.raises(InputError, match="cannot be saved"):
        save_session(tmp_path / "a.deltamic", odd)
    assert os.listdir(tmp_path) == []


# ---- files that are not as they should be --------------------------------------------------------


def rewritten(source, target, change):
    """A copy of a session file in which ``change`` replaces members."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            data = change(name, old.read(name))
            if data is not None:
                new.writestr(name, data)


def of_json(**values):
    def change(name, data):
        if name != "session.json":
            return data
        return json.dumps({**json.loads(data), **values})

    return change


def without(missing):
    return lambda name, data: None if name == missing else data


def replaced(which, content):
    return lambda name, data: content if name == which else data


def huge(name, data):
    """An image that claims far more voxels than there are."""
    return data.replace(b"(6, 7, 8)", b"(6,7,8000)", 1) if name == "image.npy" else data


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (of_json(version=99, written_by="napari-deltamic 7.1"), "newer version .napari-deltamic 7"),
        (of_json(format="something"), "not a deltaMic session"),
        (of_json(version=float("inf")), "not a deltaMic session"),
        (of_json(seeds=None), "not a deltaMic session"),
        (of_json(image={}), "not a deltaMic session"),
        (without("session.json"), "has no session.json"),
        (without("image.npy"), "has no image.npy"),
        (without("faces/0/corners.npy"), "has no faces/0/corners.npy"),
        (without("run.toml"), "has no run.toml"),
        (replaced("run.toml", b"accuracy = 7"), "damaged"),
        (replaced("run.toml", b"\xff"), "damaged"),
        (replaced("session.json", b"{"), "damaged"),
        (replaced("image.npy", b"\x93NUMPY\x01\x00"), "damaged"),
        (replaced("state/density.npy", b""), "damaged"),
        (huge, "image is damaged"),
    ],
)
def test_files_that_are_not_as_they_should_be(tmp_path, change, words):
    good, bad = tmp_path / "good.deltamic", tmp_path / "bad.deltamic"
    save_session(good, session())
    rewritten(good, bad, change)
    with pytest.raises(InputError, match=words) as caught:
        load_session(bad)
    assert str(caught.value).startswith(str(bad))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 and no more", b"a text", bytes(5000)])
def test_foreign_files(tmp_path, content):
    (tmp_path / "a.deltamic").write_bytes(content)
    with pytest.raises(InputError, match="not a deltaMic session"):
        load_session(tmp_path / "a.deltamic")


def test_a_pickle_in_a_session_is_not_opened(tmp_path):
    good, bad = tmp_path / "good.deltamic", tmp_path / "bad.deltamic"
    save_session(good, session())
    np.save(tmp_path / "odd.npy", np.array([print]), allow_pickle=True)
    rewritten(good, bad, replaced("image.npy", (tmp_path / "odd.npy").read_bytes()))
    with pytest.raises(InputError, match="damaged"):
        load_session(bad)


def test_every_cut_and_many_flipped_bytes_are_noticed_or_harmless(tmp_path):
    good, bad = tmp_path / "good.deltamic", tmp_path / "bad.deltamic"
    before = session()
    save_session(good, before)
    data = good.read_bytes()
    rng = np.random.default_rng(0)
    errors = []
    for k in range(120):
        damaged = bytearray(data)
        where = int(rng.integers(len(data)))
        if k % 3:
            damaged[where] ^= int(rng.integers(1, 256))
        else:
            del damaged[where:]
        bad.write_bytes(damaged)
        try:
            after = load_session(bad)
        except InputError as error:
            errors.append(str(error))
        else:
            assert same(after.image.pixels, before.image.pixels)
    assert not any("\n" in text for text in errors)
    assert len(errors) > 80


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_session(tmp_path / "none.deltamic")
    with pytest.raises(InputError, match="cannot be read"):
        load_session(tmp_path)
    with pytest.raises(InputError, match="cannot be written"):
        save_session(tmp_path / "no folder" / "a.deltamic", session())


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES, errno.EROFS])
def test_a_disk_that_fails_leaves_the_old_file(tmp_path, monkeypatch, code):
    path = tmp_path / "a.deltamic"
    save_session(path, session())
    old = path.read_bytes()

    def fail(descriptor):
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", fail)
        with pytest.raises(InputError, match=os.strerror(code)):
            save_session(path, session(np.uint8))
    assert path.read_bytes() == old
    assert os.listdir(tmp_path) == ["a.deltamic"]
    save_session(tmp_path / "b.deltamic", session())  # elsewhere, or later


def test_no_window_library_is_loaded():
    code = (
        "import sys, napari_deltamic.results.session_file as s; "
        "assert not {'napari', 'qtpy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("first", "frame"), [(2, 0.0), (0, 7.0), (0, np.nan)])
def test_tracks_of_frames_that_the_series_does_not_have(tmp_path, first, frame):
    own = settings()
    run = TrackRun(
        scene=own.scene, fit=own.fit, track=TrackSettings(first=first), image="", seeds=""
    )
    one = FrameResult(frame, 0.0, None, message="left out")
    tracks = SavedTracks(np.zeros((2, *SHAPE), np.uint8), (1.0, 0.0, "second"), (one,), run)
    save_session(tmp_path / "a.deltamic", replace(session(), result=None, tracks=tracks))
    with pytest.raises(InputError, match="damaged"):
        load_session(tmp_path / "a.deltamic")


def with_a_bead(tmp_path, named):
    """A session whose PSF is measured on a bead, and names this file for it; the bead's pixels."""
    image = np.random.default_rng(0).random((5, 6, 7)).astype(np.float32)
    write_image(tmp_path / "bead.tif", image, (0.1, 0.1, 0.1))
    optics = MeasuredOptics(file=str(tmp_path / "bead.tif"), voxel_size=(0.1, 0.1, 0.1))
    scene = SceneSettings(voxel_size=SIZE, optics=optics)
    whole = replace(
        session(), settings=RunSettings(image="", seeds="", scene=scene), result=None, tracks=None
    )
    save_session(tmp_path / "good.deltamic", whole)

    def change(name, data):
        old = str(tmp_path / "bead.tif").encode()
        return data.replace(old, named.encode()) if name == "run.toml" else data

    rewritten(tmp_path / "good.deltamic", tmp_path / "a.deltamic", change)
    return image


def test_the_bead_that_a_session_holds_wins(tmp_path):
    """The path that it names may lead anywhere."""
    write_image(tmp_path / "trap.tif", np.ones((4, 4, 4), np.float32), (0.1, 0.1, 0.1))
    image = with_a_bead(tmp_path, str(tmp_path / "trap.tif"))
    found = load_session(tmp_path / "a.deltamic").settings.scene.optics.file
    assert np.array_equal(read_image(found)[0], image)


def test_a_session_opens_no_file_that_it_names(tmp_path, monkeypatch):
    with_a_bead(tmp_path, "//elsewhere/share/bead.tif")
    asked = []
    stat = os.stat

    def watched(path, *arguments, **options):
        asked.append(str(path))
        return stat(path, *arguments, **options)

    monkeypatch.setattr(os, "stat", watched)
    load_session(tmp_path / "a.deltamic")
    assert not [path for path in asked if "elsewhere" in path]

    def without_it(name, data):
        return None if name == "run/bead.npy" else data

    rewritten(tmp_path / "a.deltamic", tmp_path / "b.deltamic", without_it)
    with pytest.raises(InputError, match="does not hold the image of the bead"):
        load_session(tmp_path / "b.deltamic")
    assert not [path for path in asked if "elsewhere" in path]


def test_temporary_folders_go(tmp_path):
    with_a_bead(tmp_path, "bead.tif")
    code = (
        "import sys; from napari_deltamic.results.session_file import load_session\n"
        "print(load_session(sys.argv[1]).settings.scene.optics.file)"
    )
    words = [sys.executable, "-c", code, str(tmp_path / "a.deltamic")]
    done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120)
    path = done.stdout.strip()
    assert path.endswith("bead.tif")
    assert not os.path.exists(os.path.dirname(path))
