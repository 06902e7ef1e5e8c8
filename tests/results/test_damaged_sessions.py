"""Session files that are not as they should be are refused in one line, which names the file."""

import json
from dataclasses import replace

import numpy as np
import pytest
from saved_sessions import SHAPE, rewritten, same, session, settings

from napari_deltamic.errors import InputError
from napari_deltamic.results.session_file import load_session, save_session
from napari_deltamic.results.session_parts import SavedTracks
from napari_deltamic.runs.track_run import TrackRun
from napari_deltamic.tracking import FrameResult, TrackSettings


def of_json(**values):
    def change(name, data):
        if name != "session.json":
            return data
        return json.dumps({**json.loads(data), **values})

    return change


def of_state(**values):
    """Other values of a state; without those that are None."""

    def change(name, data):
        if name != "session.json":
            return data
        facts = json.loads(data)
        state = {**facts["result"]["state"], **values}
        facts["result"]["state"] = {k: v for k, v in state.items() if v is not None}
        return json.dumps(facts)

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
        (of_json(image={}), "one .image.name: it must be given"),
        (of_state(light=None), "one .result.state.light: it must be given"),
        (of_state(light={"membrane": 1.0, "interior": 0.0}), "one .there is no 'cells'"),
        (of_state(effects=None), "one .result.state.effects: it must be given"),
        (of_state(effects={"bulk": {}}), "one .bulk is no effect: light inside"),
        (of_state(effects={"magic": {}}), "one .unknown effect 'magic'"),
        (of_state(effects={"halo": {"size": 1}}), "one .halo.size: there is no such setting"),
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
