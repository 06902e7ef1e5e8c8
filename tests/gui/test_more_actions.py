"""Copy as command: nothing that takes long happens on the thread of the window."""

import threading

import numpy as np
import pytest

from napari_deltamic.gui.results import more_actions
from napari_deltamic.images.stacks import write_image
from napari_deltamic.runs import seeds

from .conftest import CENTER
from .seeding import PLACE


@pytest.fixture
def mixture(make_widget, with_image, ball_labels, monkeypatch, tmp_path):
    """A widget whose seeds are a point in a membrane and a label: they must be computed to save."""
    widget = make_widget()
    with_image.add_labels(ball_labels, **PLACE)
    widget.seeds.place.click()
    with_image.layers["seeds"].add(CENTER)
    monkeypatch.setattr(
        more_actions.QFileDialog, "getExistingDirectory", staticmethod(lambda *a: str(tmp_path))
    )
    return widget


def test_membranes_are_found_in_the_background(mixture, told, spin, monkeypatch, tmp_path):
    threads, find = [], seeds.seeds_from_points

    def watched(*arguments, **options):
        threads.append(threading.current_thread())
        return find(*arguments, **options)

    monkeypatch.setattr(seeds, "seeds_from_points", watched)
    mixture.commands.copy_action.trigger()
    assert mixture.commands.background.busy
    assert "command" in mixture.running.note.text()
    spin(lambda: not mixture.commands.background.busy)
    assert threads
    assert threading.main_thread() not in threads
    text = more_actions.QApplication.clipboard().text()
    assert text.startswith("napari-deltamic fit ")
    assert str(tmp_path) in text
    assert told[-1] == f"copied: {text}"
    assert not mixture.running.note.text()


def test_what_fails_is_told(mixture, with_image, told, spin):
    with_image.layers["seeds"].data = np.array([[50.0, 50.0, 50.0]])
    mixture.commands.copy_action.trigger()
    spin(lambda: not mixture.commands.background.busy)
    assert told
    assert told[-1] == mixture.running.note.text() != ""


def test_closing_asks_nobody_any_more(mixture, told, spin, monkeypatch):
    asked = []
    monkeypatch.setattr(
        more_actions.QFileDialog,
        "getExistingDirectory",
        staticmethod(lambda *a: asked.append(a) or ""),
    )
    mixture.commands.copy_action.trigger()
    mixture.close_links()
    spin(seconds=0.2, must=False)
    assert not asked
    assert not told


def test_a_folder_gets_a_batch_file(mixture, told, tmp_path):
    write_image(tmp_path / "a.tif", np.ones((4, 5, 6), np.float32), (0.3, 0.2, 0.2))
    mixture.commands.folder_action.trigger()
    assert told[-1].startswith("copied: napari-deltamic batch ")
    assert more_actions.QApplication.clipboard().text() in told[-1]
    assert 'images = ["a.tif"]' in (tmp_path / "batch.toml").read_text()
    mixture.commands.folder_action.trigger()
    assert "is there already" in told[-1]
