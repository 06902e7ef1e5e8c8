"""A session file gives back what was saved."""

import errno
import os
import subprocess
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from saved_sessions import (
    SHAPE,
    SIZE,
    rewritten,
    same,
    same_mesh,
    session,
)

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.geometry import files
from napari_deltamic.geometry.judgement import Judgement
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.results.session_file import (
    load_session,
    save_session,
)
from napari_deltamic.results.session_parts import SavedTracks
from napari_deltamic.runs.optics_settings import MeasuredOptics
from napari_deltamic.runs.settings import RunSettings, SceneSettings
from napari_deltamic.runs.track_run import TrackRun
from napari_deltamic.tracking import Event, FrameResult


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
    for name in (*scalars, "effects", "moving"):
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


def with_state(before, **parts):
    state = replace(before.result.state, **parts)
    return replace(before, result=replace(before.result, state=state))


def test_dark_nuclei_are_kept(tmp_path):
    before = session()
    dimmed = np.random.default_rng(0).random(SHAPE).astype(np.float32)
    save_session(tmp_path / "a.deltamic", with_state(before, dimmed=dimmed))
    after = load_session(tmp_path / "a.deltamic").result.state
    np.testing.assert_array_equal(after.dimmed, dimmed)
    save_session(tmp_path / "even.deltamic", before)
    even = load_session(tmp_path / "even.deltamic").result.state.rendered()
    shown = after.background + dimmed * (even - after.background)
    np.testing.assert_allclose(after.rendered(), shown, rtol=1e-5)
    save_session(tmp_path / "b.deltamic", with_state(before, dimmed=dimmed[1:]))
    with pytest.raises(InputError, match="nuclei belong to another image"):
        load_session(tmp_path / "b.deltamic")


def test_a_local_background_is_kept(tmp_path):
    before = session()
    around = np.random.default_rng(0).random(SHAPE).astype(np.float32)
    save_session(tmp_path / "a.deltamic", with_state(before, local_background=around))
    after = load_session(tmp_path / "a.deltamic").result.state
    np.testing.assert_array_equal(after.local_background, around)
    save_session(tmp_path / "even.deltamic", before)
    even = load_session(tmp_path / "even.deltamic").result.state
    assert even.local_background is None
    np.testing.assert_allclose(after.rendered(), even.rendered() + around, rtol=1e-5)
    save_session(tmp_path / "b.deltamic", with_state(before, local_background=around[1:]))
    with pytest.raises(InputError, match="local background belongs to another image"):
        load_session(tmp_path / "b.deltamic")


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


def test_a_session_without_its_bead_is_not_written(tmp_path):
    """It could not be opened again."""
    optics = MeasuredOptics(file=str(tmp_path / "gone.tif"), voxel_size=(0.1, 0.1, 0.1))
    scene = SceneSettings(voxel_size=SIZE, optics=optics)
    whole = replace(session(), settings=RunSettings(image="", seeds="", scene=scene))
    with pytest.raises(InputError, match=r"put it back \(.*gone.tif: there is no such file\)"):
        save_session(tmp_path / "a.deltamic", whole)
    assert list(tmp_path.iterdir()) == []


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


def test_frames_of_a_series_come_back_with_all_that_is_known_of_them(tmp_path):
    event = Event("divided", 0, 1, "it divided", (2, 3))
    frames = (
        FrameResult(
            0, 0.1, session().result.state.mesh, "odd", (event,), 1 / 3, 7, 0.1 + 0.2,
            (0.3, 0.2, 0.1), (0.1, 1 / 7), "membrane", (0.1, 0.2, 0.3), "fair", "few voxels",
            {3: Judgement("fair", 0.1, "few voxels")},
        ),
        FrameResult(1, 5.1, None, "dark"),
    )  # fmt: skip
    run = TrackRun(image="", seeds="", scene=SceneSettings(voxel_size=SIZE))
    tracks = SavedTracks(np.zeros((2, *SHAPE), np.uint8), (5.0, 0.1, "second"), frames, run)
    save_session(tmp_path / "a.deltamic", replace(session(), result=None, tracks=tracks))
    again = load_session(tmp_path / "a.deltamic").tracks.results
    assert same_mesh(again[0].mesh, frames[0].mesh)
    assert again[1].mesh is None
    for old, new in zip(frames, again, strict=True):
        assert repr(replace(new, mesh=None)) == repr(replace(old, mesh=None))
