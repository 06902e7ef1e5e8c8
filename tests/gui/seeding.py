"""What the tests of seeds share."""

from .conftest import SHAPE, SIZE

PLACE = {"scale": SIZE, "translate": (1, 2, 3), "units": ("um",) * 3}
FRAME = {"translate": (1, 2, 3), "units": ("um",) * 3}
MEMBRANE, SPHERE = 0, 1


def add_points(panel, viewer, *points):
    panel.place.click()
    layer = viewer.layers["seeds"]
    for point in points:
        layer.add(point)
    return layer


def texts(panel):
    return [remark.text for remark in panel.remarks.remarks]


def taken(panel):
    return panel.cells.seeds(panel._image.frame())


def grid_of(panel):
    return panel._image.frame().grid(SHAPE)
