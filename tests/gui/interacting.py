"""What the tests of a fit that is changed by hand share."""

import numpy as np

from .conftest import CENTER
from .mouse import Mouse

ALONG_X = np.array([0.0, 0.0, 1.0])


def vertices(widget):
    return widget.doc.link.shown.vertices_numpy()


def use(widget, tool, radius=0.8):
    widget.running.edit.use(tool)
    widget.running.edit.radius.setValue(radius)
    return Mouse(widget.doc.link.viewer, widget.doc.link)


def right_end(widget):
    """The point of the mesh that lies farthest along X in the slice through its centre."""
    v = vertices(widget)
    return np.array([CENTER[0], CENTER[1], v[:, 2].max()])


def went_on(widget, n=5):
    """Whether a fit has done so many iterations, and the window shows it."""
    return lambda: widget.doc.begun and len(widget.doc.run.history.loss) >= n


def pause(widget, spin):
    """Pause the fit, and wait until it stands, and its last mesh is shown."""
    run = widget.doc.run
    widget.footer.pause_button.click()
    spin(lambda: run.stage == "paused" and widget.doc.link.mesh is run.state.mesh)


def notes(widget):
    return [m.note for m in widget.doc.timeline.moments if m.note]
