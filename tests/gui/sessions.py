"""What the tests of sessions share."""

from napari_deltamic.results.cell_columns import COLUMNS, FIRST

from .dialing import show_psf

AT_ONCE = [k for k, column in enumerate(COLUMNS) if column.key in FIRST[:4]]


def done(widget):
    return lambda: widget.doc.run is None or not widget.doc.run.running


def fitted(widget, spin):
    """With other settings than by default, and a result."""
    widget.settings.accuracy.setCurrentText("3e-3")
    widget.settings.fit_psf.setChecked(True)
    widget.settings.density.setCurrentText("smooth")
    show_psf(widget.doc, sigma=(0.4, 0.25, 0.23))
    widget.settings.max_iterations.setValue(12)
    widget.start()
    spin(done(widget))
    return widget


def save(widget, path, spin):
    widget.sessions.save(str(path))
    spin(lambda: path.exists() and not widget.sessions.busy)


def cells(widget):
    """What the table shows at once; the rest comes from the background."""
    table = widget.results.table
    return [[table.item(r, c).text() for c in AT_ONCE] for r in range(table.rowCount())]


def shown(widget):
    """What the panels say."""
    running, seeds = widget.running, widget.seeds
    return {
        "fit": widget.doc.settings.fit_settings(),
        "scene": widget.doc.settings.scene_settings(),
        "start as": seeds.shape.currentText(),
        "radius": seeds.radius.value(),
        "cells": cells(widget),
        "verdict": (running.verdict.text(), running.verdict.styleSheet()),
        "numbers": running.numbers.texts(),
        "loss": [(line.x, line.y) for line in running.curve.lines],
        "history": [
            (m.iteration, m.loss, m.note, m.optics.sigma_um) for m in widget.doc.timeline.moments
        ],
        "slider": (running.history.slider.maximum(), running.history.slider.isEnabled()),
        "view": widget.doc.view,
        "can be saved": widget.results.isEnabled(),
    }
