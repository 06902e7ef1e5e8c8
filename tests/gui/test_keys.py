"""The keys of the window: none is napari's, and a press does what the docs say."""

import re
from pathlib import Path

import numpy as np
import pytest
from app_model.types import KeyBinding
from napari import layers
from napari._app_model import get_app_model
from napari.utils.key_bindings import coerce_keybinding
from napari.utils.shortcuts import default_shortcuts
from qtpy.QtCore import Qt
from qtpy.QtGui import QAction
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QMenu, QMenuBar

from napari_deltamic.gui.fit_widget import FitWidget

from .conftest import SIZE

DOCS = Path(__file__).parents[2] / "docs" / "napari.md"
WITH_ACTION = ("Shift+C", "Shift+F", "Shift+H", "Shift+W", "Shift+S")
KINDS = ("Image", "Labels", "Points", "Shapes", "Surface", "Tracks", "Vectors")


def documented():
    """The keys that the docs name in the paragraph about them."""
    (text,) = re.findall(r"^Keys, .*?\n\n", DOCS.read_text(), re.MULTILINE | re.DOTALL)
    return re.findall(r"\b(?:(?:Ctrl|Alt|Shift|Meta)\+)+\w\b", text)


def key(text):
    return str(KeyBinding.from_str(text.replace("Ctrl", "Control")))


def of_menus(window):
    """Alt with a letter opens a menu; that is not so on macOS only."""
    bar = window.findChild(QMenuBar)
    titles = [a.text() for menu in (bar, *bar.findChildren(QMenu)) for a in menu.actions()]
    letters = [found[1] for title in titles if (found := re.search(r"&(\w)", title))]
    return {key(f"Alt+{letter.upper()}") for letter in letters}


def of_actions(window):
    """Shortcuts of the window, and those that actions have wherever they are."""
    shown = [a.shortcut().toString() for a in window.findChildren(QAction)]
    bound = [rule.keybinding for rule in get_app_model().keybindings]
    return {key(text) for text in shown if re.fullmatch(r"[\w+]+", text)} | set(map(str, bound))


def of_keymaps(viewer):
    """Keys of the viewer and of layers, also those that are there by default only."""
    named = [type(viewer), *(getattr(layers, kind) for kind in KINDS)]
    bases = {base for one in named for base in one.__mro__}
    own = [bound for base in bases for bound in vars(base).get("class_keymap", {})]
    default = [bound for keys in default_shortcuts.values() for bound in keys]
    return {str(coerce_keybinding(bound)) for bound in (*own, *default)}


def test_no_key_is_one_of_napari(window):
    shown = window.window._qt_window
    taken = of_menus(shown) | of_actions(shown) | of_keymaps(window)
    once = [key(f"Alt+{letter}") for letter in "CFPVW"]
    assert set(once) <= taken, "napari's own are found"
    assert key("Shift+V") in taken
    assert key("Ctrl+Shift+P") in taken
    assert not taken & {key(text) for text in documented()}


def test_the_keys_are_those_of_the_docs(make_widget, with_image):
    make_widget()
    bound = {str(one) for one in with_image.keymap}
    assert bound == {key(text) for text in documented()} == {key(text) for text in WITH_ACTION}


@pytest.fixture
def docked(window, pixels):
    window.add_image(pixels, scale=SIZE, name="cell")
    widget = FitWidget(window)
    window.window.add_dock_widget(widget, name="deltaMic")
    yield widget
    widget.close_links()


def press(window, text):
    """In the canvas."""
    canvas, shift = window.window._qt_viewer.canvas.native, Qt.KeyboardModifier.ShiftModifier
    QTest.keyClick(canvas, getattr(Qt.Key, f"Key_{text[-1]}"), shift)
    QTest.keyRelease(canvas, Qt.Key.Key_Shift)  # else Qt takes Shift for held in later tests


@pytest.mark.parametrize(
    "kind",
    ["image", "labels", *(pytest.param(k, marks=pytest.mark.slow) for k in ("points", "shapes"))],
)
def test_every_key_arrives_whatever_layer_is_selected(window, docked, monkeypatch, kind, pixels):
    if kind != "image":
        given = [np.zeros(pixels.shape, int)] if kind == "labels" else []
        getattr(window, f"add_{kind}")(*given)
    called = []
    for bound in list(window.keymap):
        note = lambda viewer, bound=bound: called.append(str(bound))  # noqa: E731
        monkeypatch.setitem(window.keymap, bound, note)
    for text in WITH_ACTION:
        press(window, text)
    assert called == list(map(key, WITH_ACTION))


def test_a_key_does_what_the_docs_say(window, docked, told):
    views = []
    for _ in range(4):
        press(window, "Shift+S")
        views.append(docked.doc.view)
    assert views == ["rendered", "residual", "side by side", "image"]
    press(window, "Shift+F")
    assert "seeds" in told[-1] or "cells" in told[-1], "a fit cannot start without them"
