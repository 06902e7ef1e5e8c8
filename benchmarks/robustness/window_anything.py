"""Using whatever field, button, table or entry of a menu is there; see ``window``."""

from __future__ import annotations

from typing import Any

from .window_session import Session


def anything(s: Session) -> None:
    """Use any field, button, table or entry of the menu that is there."""
    from qtpy.QtWidgets import (
        QAbstractButton,
        QAbstractSlider,
        QAbstractSpinBox,
        QComboBox,
        QLineEdit,
        QListWidget,
        QScrollBar,
        QTableWidget,
        QWidget,
    )

    kinds = (QAbstractButton, QAbstractSlider, QAbstractSpinBox, QComboBox, QLineEdit)
    seen = [
        one
        for one in s.widget.findChildren(QWidget)
        if isinstance(one, (*kinds, QTableWidget, QListWidget))
        and not isinstance(one, QScrollBar)
        and one.isEnabled()
        and one.isVisibleTo(s.widget)
    ]
    if not seen:
        return
    one: Any = s.rng.choice(seen)
    rng, menu = s.rng, getattr(one, "menu", lambda: None)()
    s.said(f"{type(one).__name__} {getattr(one, 'text', str)()}")
    if menu is not None:
        menu.aboutToShow.emit()
        rng.choice([entry for entry in menu.actions() if entry.text()]).trigger()
    elif isinstance(one, QAbstractButton):
        one.click()
    elif isinstance(one, QComboBox):
        any_item(s, one)
        if one.isEditable():
            one.setCurrentText(rng.choice(["quick", "20 nm", "1e-3", "nonsense", "", "1.33"]))
            one.lineEdit().editingFinished.emit()
    elif isinstance(one, QAbstractSpinBox):
        one.setValue(type(one.value())(rng.choice([0, 1, 0.3, 2, 50, 1e4])))
    elif isinstance(one, QAbstractSlider):
        one.setValue(type(one.value())(rng.uniform(one.minimum(), one.maximum())))
    elif isinstance(one, QLineEdit):
        before = one.text()
        one.setText(rng.choice(["", "1", "4, 2 1", "words", "-1"]))
        if one.hasAcceptableInput():
            one.editingFinished.emit()
        else:  # what cannot be typed
            one.setText(before)
    elif isinstance(one, QTableWidget) and one.rowCount():
        item = one.item(rng.randrange(one.rowCount()), rng.randrange(one.columnCount()))
        if item is not None:
            one.setCurrentItem(item)
    elif isinstance(one, QListWidget) and one.count():
        one.itemClicked.emit(one.item(rng.randrange(one.count())))
    s.did["anything"] += 1


def any_item(s: Session, box: Any) -> None:
    if box.count():
        index = s.rng.randrange(box.count())
        box.setCurrentIndex(index)
        box.activated.emit(index)
