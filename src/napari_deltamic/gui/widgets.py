"""Small widgets that several panels use: buttons, choosers of layers, notes, folds, tool bars."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from qtpy import QtCore, QtGui
from qtpy.QtCore import Qt
from qtpy.QtGui import QResizeEvent
from qtpy.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLayout,
    QMessageBox,
    QPushButton,
    QSizePolicy,
    QTableWidget,
    QTableWidgetItem,
    QToolButton,
    QVBoxLayout,
    QWidget,
)
from superqt import QLabeledDoubleSlider
from superqt.utils import signals_blocked

from .document import Document
from .layer_choice import LayerChoice
from .window_words import as_tip, for_window

# The bindings' type stubs do not agree on these two.
Signal: Any = QtCore.Signal  # type: ignore[attr-defined]
QAction: Any = QtGui.QAction  # type: ignore[attr-defined]


def action(title: str, tip: str, slot: Callable[[], object], parent: Any) -> Any:
    """An entry of a menu."""
    made = QAction(title, parent)
    made.setToolTip(for_window(tip))
    made.triggered.connect(lambda checked=False: slot())
    return made


# On a dark ground, and on a light one: on either each of them has a contrast of 4.5 at least.
_GREEN, _AMBER, _RED = ("#3fae6b", "#17703c"), ("#d99a1c", "#855600"), ("#f0746d", "#b3271e")
# How something ended, and how good it is.
VERDICTS = {"ended": _AMBER, "stopped": _AMBER, "failed": _RED, "done": _GREEN}
VERDICTS |= {"good": _GREEN, "fair": _AMBER, "poor": _RED}
_ARROW = 30  # px of the button of a fold that are not for its text


class LayerChooser(QComboBox):
    """Shows a choice of layers, and lets the user make it."""

    def __init__(self, choice: LayerChoice, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.choice = choice
        be_narrow(self)
        choice.listed.connect(self._show)
        self.currentIndexChanged.connect(self._chosen)
        self._show()

    def _shown(self) -> list[Any]:
        return [None, *self.choice.layers] if self.choice.optional else self.choice.layers

    def _show(self) -> None:
        layers, chosen = self._shown(), self.choice.layer
        with signals_blocked(self):
            self.clear()
            self.addItems(["none" if layer is None else layer.name for layer in layers])
            self.setCurrentIndex(layers.index(chosen) if chosen in layers else -1)

    def _chosen(self, index: int) -> None:
        layers = self._shown()
        if 0 <= index < len(layers):
            self.choice.choose(layers[index])


def be_narrow(box: QComboBox, characters: int = 12) -> None:
    """Limit the width of a box, so that long names do not widen a narrow dock."""
    box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
    box.setMinimumContentsLength(characters)
    box.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)


def narrow_box(
    parent: QWidget, name: str, tip: str, items: Iterable[str] = (), characters: int = 12
) -> QComboBox:
    """A combo box that long names do not widen."""
    box = QComboBox(parent)
    box.setAccessibleName(name)
    box.setToolTip(as_tip(tip))
    box.addItems(list(items))
    be_narrow(box, characters)
    return box


def button(title: str, tip: str, slot: Any, parent: QWidget) -> QPushButton:
    """A button that does something when it is pressed; without a slot, others connect it."""
    made = QPushButton(title, parent)
    made.setToolTip(as_tip(tip))
    if slot is not None:
        made.clicked.connect(slot)
    return made


def slider(tip: str, parent: QWidget | None) -> QLabeledDoubleSlider:
    """A slider for a length, beside its number."""
    made = QLabeledDoubleSlider(Qt.Orientation.Horizontal, parent)
    made.setToolTip(as_tip(tip))
    return made


def confirmed(parent: QWidget, title: str, text: str, yes: str, no: str) -> bool:
    """Ask whether the user wants something that cannot be undone; Escape means no.

    yes, no : what is on the buttons.
    """
    box = QMessageBox(QMessageBox.Icon.Question, title, text, parent=parent)
    wanted = box.addButton(yes, QMessageBox.ButtonRole.DestructiveRole)
    other = box.addButton(no, QMessageBox.ButtonRole.RejectRole)
    box.setDefaultButton(other)
    box.setEscapeButton(other)
    box.exec()
    return box.clickedButton() is wanted


def small(made: QPushButton) -> QPushButton:
    """The button itself, made as narrow as the sign on it."""
    made.setFixedWidth(30)
    made.setStyleSheet("padding: 2px; font-size: 15px;")
    return made


def filled(layout: Any, *parts: Any) -> Any:
    """The layout, filled with widgets and layouts; a number with one is its stretch."""
    for part in parts:
        part, stretch = part if isinstance(part, tuple) else (part, 0)
        add = layout.addLayout if isinstance(part, QLayout) else layout.addWidget
        add(part, stretch)
    return layout


def row(*parts: Any, of: QWidget | None = None, spacing: int | None = None) -> QHBoxLayout:
    """A layout of parts side by side, without a margin; of : widget whose content it becomes."""
    return _bare(QHBoxLayout(of), parts, spacing)


def column(*parts: Any, of: QWidget | None = None, spacing: int | None = None) -> QVBoxLayout:
    """The same, one below the other."""
    return _bare(QVBoxLayout(of), parts, spacing)


def _bare(layout: Any, parts: Sequence[Any], spacing: int | None) -> Any:
    layout.setContentsMargins(0, 0, 0, 0)
    if spacing is not None:
        layout.setSpacing(spacing)
    return filled(layout, *parts)


def is_dark(widget: QWidget) -> bool:
    """Whether the background of a widget is dark in the present theme."""
    return widget.palette().color(QtGui.QPalette.ColorRole.Window).lightness() < 128


def be_table_of_rows(table: QTableWidget, titles: Iterable[tuple[str, str]], narrowest: int) -> Any:
    """Rows are chosen, not edited, and columns as wide as what they hold; the header, for more.

    titles : of the columns, each with its tooltip.
    """
    for number, (title, tip) in enumerate(titles):
        item = QTableWidgetItem(title)
        item.setToolTip(as_tip(tip))
        table.setHorizontalHeaderItem(number, item)
    rows: Any = table.verticalHeader()
    rows.setVisible(False)
    columns: Any = table.horizontalHeader()
    columns.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
    columns.setHighlightSections(False)
    columns.setMinimumSectionSize(narrowest)  # px
    table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
    table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
    return columns


def be_as_high_as_rows(view: QAbstractItemView) -> None:
    """Make all rows visible, so that the column scrolls and not the view."""
    view.setSizeAdjustPolicy(QAbstractItemView.SizeAdjustPolicy.AdjustToContents)
    view.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)


class Note(QLabel):
    """A small line, wrapped, that is hidden while it is empty.

    Parameters
    ----------
    verdict : one of ``VERDICTS``, which gives it a colour that suits the theme; '' for none.
    style : Qt's, but for the colour.
    """

    def __init__(
        self, parent: QWidget | None = None, verdict: str = "", style: str = "font-size: 11px;"
    ) -> None:
        super().__init__(parent)
        self.verdict, self._style = verdict, style
        self.setWordWrap(True)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
        self._colour()
        self.hide()

    def say(self, text: str, verdict: str | None = None) -> None:
        """Show a text, in the colour of a verdict; None: in that of the last one."""
        if verdict is not None:
            self.verdict = verdict
            self._colour()
        shown = for_window(text)
        if shown != self.text():
            self.setText(shown)
            self.setVisible(bool(shown))

    def changeEvent(self, event: QtCore.QEvent | None) -> None:
        """Called by Qt: renews the colour, as the theme may have changed."""
        super().changeEvent(event)
        if event is not None and event.type() == QtCore.QEvent.Type.StyleChange:
            self._colour()

    def _colour(self) -> None:
        colours, style = VERDICTS.get(self.verdict), self._style
        style += f" color: {colours[not is_dark(self)]};" if colours else ""
        if style != self.styleSheet():
            self.setStyleSheet(style)


class ToolBar(QWidget):
    """Buttons for tools of the mouse, and what the one in use does; one of the window is, or none.

    Parameters
    ----------
    tools : title of each, and what it does, by name.
    more : what else is to be known of a tool in a view of so many dimensions.
    """

    tool_chosen = Signal(object)  # a tool, or None

    def __init__(
        self,
        tools: Mapping[str, tuple[str, str]],
        more: Callable[[str, int], str],
        doc: Document,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self._tools, self._more, self._doc = tools, more, doc
        self.buttons: dict[str, QPushButton] = {}
        self.hint = Note(self)
        self.row = row(spacing=4)
        self.column = column(self.row, self.hint, of=self)
        for tool, (title, tip) in tools.items():
            one = button(title, tip, partial(self._clicked, tool), self)
            one.setCheckable(True)
            self.buttons[tool] = one
            self.row.addWidget(one, 1)
        doc.finish_tools.connect(self._other_tool)
        doc.listen(doc.viewer.dims.events.ndisplay, self.explain)

    @property
    def tool(self) -> Any:
        """The tool in use, or None."""
        return next((tool for tool, one in self.buttons.items() if one.isChecked()), None)

    def use(self, tool: str | None) -> None:
        if tool != self.tool:
            for name, one in self.buttons.items():
                one.setChecked(name == tool)
            self.explain()
            if tool is not None:
                self._doc.finish_tools.emit(self)
            self.tool_chosen.emit(tool)

    def explain(self) -> None:
        """Show what the tool in use does."""
        tool, ndisplay = self.tool, self._doc.viewer.dims.ndisplay
        more = f"{self._tools[tool][1]} {self._more(tool, ndisplay)}" if tool else ""
        self.hint.say(more.strip())

    def _clicked(self, tool: str, checked: bool) -> None:
        self.buttons[tool].setChecked(not checked)  # as it was
        self.use(tool if checked else None)

    def _other_tool(self, tool: object) -> None:
        """Put the tool away if another tool bar uses the mouse."""
        if tool is not self:
            self.use(None)


class Fold(QWidget):
    """A title with an arrow; a click on it shows the content, or hides it again.

    A title that is longer than the panel is wide is cut; its tooltip has all of it.
    """

    def __init__(self, title: str, content: Any, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.title = ""
        self.button = QToolButton(self)
        self.button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.button.setCheckable(True)
        # The text must not widen a narrow dock.
        self.button.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        # napari's style would draw it as one of its square icons.
        self.button.setStyleSheet(
            "QToolButton { border: none; background: transparent; padding: 2px; }"
        )
        self.content = content
        column(self.button, content, of=self, spacing=4)
        self.button.toggled.connect(self.unfold)
        self.set_title(title)
        self.unfold(False)

    def set_title(self, title: str) -> None:
        self.title = title
        self._cut()

    def unfold(self, shown: bool = True) -> None:
        self.button.setChecked(shown)
        arrow = Qt.ArrowType.DownArrow if shown else Qt.ArrowType.RightArrow
        self.button.setArrowType(arrow)
        self.content.setVisible(shown)

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        super().resizeEvent(event)
        self._cut()

    def _cut(self) -> None:
        room = self.width() - _ARROW
        metrics = self.button.fontMetrics()
        text = metrics.elidedText(self.title, Qt.TextElideMode.ElideRight, room)
        self.button.setText(text)
        self.button.setToolTip(self.title if text != self.title else "")
