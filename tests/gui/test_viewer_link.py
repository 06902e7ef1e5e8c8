"""The layers that show a fit, when layers of the user go meanwhile."""

import numpy as np

from napari_deltamic.geometry import sphere
from napari_deltamic.gui.viewing.frame import Frame
from napari_deltamic.gui.viewing.viewer_link import ViewerLink


def test_the_rendered_image_is_shown_though_the_measured_one_was_removed(viewer):
    pixels, lost = np.zeros((6, 7, 8)), []
    layer = viewer.add_image(pixels, name="cell")
    link = ViewerLink(viewer, layer, Frame.of(layer), lost.append)
    link.show_mesh(sphere((3, 3, 3), 2, edge_length=1))
    viewer.layers.remove(layer)
    link.take_images(pixels, pixels)
    for view in ("model", "difference"):
        link.look(view)
    link.close()
    assert lost == ["the image layer was removed"]
    assert {"cell rendered", "cell residual"} <= {one.name for one in viewer.layers}
