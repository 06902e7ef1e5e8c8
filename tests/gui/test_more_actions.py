"""Copy as command: nothing that takes long happens on the thread of the window."""

import threading
from itertools import pairwise

import numpy as np
import pytest

from napari_deltamic.gui.results import more_actions
from napari_deltamic.images.stacks import write_image
from napari_deltamic.runs import seeds
from napari_deltamic.runs.batch import batch_jobs

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


@pytest.fixture
def asked(mixture, monkeypatch):
    """What a dialog for folders was asked with, which is left without a choice."""
    calls = []
    dialog = staticmethod(lambda *given: calls.append(given) or "")
    monkeypatch.setattr(more_actions.QFileDialog, "getExistingDirectory", dialog)
    return calls


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
    assert len(told) == 1
    assert mixture.running.note.text() == "", "it is not about a fit"


def test_closing_asks_nobody_any_more(mixture, told, spin, asked):
    mixture.commands.copy_action.trigger()
    mixture.close_links()
    spin(seconds=0.2, must=False)
    assert not asked
    assert not told


def test_a_folder_gets_a_batch_file(mixture, told, tmp_path):
    write_image(tmp_path / "a.tif", np.ones((4, 5, 6), np.float32), (0.3, 0.2, 0.2))
    for layer in mixture.doc.cells.ticked:
        mixture.doc.cells.choose(layer, False)  # no cells are needed
    mixture.commands.folder_action.trigger()
    assert told[-1].startswith("nothing runs yet: paste the command")
    assert f"batch.toml was written to {tmp_path}" in told[-1]
    command = more_actions.QApplication.clipboard().text()
    assert command.startswith(f"napari-deltamic batch {tmp_path / 'batch.toml'}")
    assert 'seeds = "auto"' in (tmp_path / "batch.toml").read_text()
    assert 'images = ["a.tif"]' in (tmp_path / "batch.toml").read_text()
    mixture.commands.folder_action.trigger()
    assert "is there already" in told[-1]
    assert mixture.running.note.text() == "", "it is not about a fit"


@pytest.mark.parametrize(
    ("choice", "given"),
    [("quick", None), ("careful", None), ("normal", None), ("exact", "0"), ("3e-3", "0.003")],
)
def test_a_folder_takes_the_accuracy_of_each_stack(mixture, tmp_path, choice, given):
    """Only an accuracy that the user gave is of all stacks; a name is one of each stack's noise."""
    write_image(tmp_path / "a.tif", np.ones((4, 5, 6), np.float32), (0.3, 0.2, 0.2))
    mixture.settings.accuracy.setCurrentText(choice)
    mixture.commands.folder_action.trigger()
    words = batch_jobs(tmp_path / "batch.toml")[0].options
    found = words[words.index("--accuracy") + 1] if "--accuracy" in words else None
    assert (found if found is None else float(found)) == (given if given is None else float(given))
    named = choice in ("quick", "careful")
    assert (("--shape-error", choice) in pairwise(words)) == named


def test_no_folder_is_asked_for_without_an_image(mixture, with_image, told, asked):
    with_image.layers.remove("cell")
    mixture.commands.folder_action.trigger()
    assert "3D image" in told[-1]
    assert not asked
