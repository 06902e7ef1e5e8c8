"""Charts: what is drawn where, and what is refused."""

import io

import numpy as np
import pytest
from PIL import Image

from napari_deltamic.accuracy.accuracy_chart import (
    shape_answer,
    shape_chart,
    shape_table,
    short,
    ways_chart,
    ways_table,
)
from napari_deltamic.accuracy.log_chart import PALETTE, Chart, Note, Series, time_text
from napari_deltamic.accuracy.shape_error import ShapeError
from napari_deltamic.accuracy.tradeoff import Way, with_front
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.shape_dial import Dialled
from napari_deltamic.runs.fit_settings import SHAPE_CHOICES


def chart(*series, notes=(), **more):
    return Chart("A title", "across", "up", list(series), notes, **more)


def drawn(chart):
    """(H, W, 3) pixels."""
    return np.asarray(Image.open(io.BytesIO(chart.png())).convert("RGB"))


def centre(picture, colour):
    """(x, y) of the middle of a colour's pixels in the axes, and how many there are."""
    array = np.asarray(picture).astype(int)
    red_green_blue = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    found = np.argwhere(np.abs(array - red_green_blue).sum(-1) < 12)
    return found[:, ::-1].mean(0) if len(found) else None, len(found)


def test_points_are_where_they_belong():
    low = Series("", [1e-2], [1e-4], 0)
    high = Series("", [1.0], [1e-1], 1)
    middle = Series("", [1e-1], [10**-2.5], 2)
    picture = drawn(chart(low, high, middle))
    places = [centre(picture, PALETTE[i])[0] for i in range(3)]
    # Logarithmic along both: the third lies half way between the others, and up is less.
    assert np.allclose(places[2], (places[0] + places[1]) / 2, atol=1.5)
    assert places[0][0] < places[1][0]
    assert places[0][1] > places[1][1]


def test_lines_and_spreads_add_ink():
    bare = centre(drawn(chart(Series("", [1, 10], [1, 10]))), PALETTE[0])[1]
    line = centre(drawn(chart(Series("", [1, 10], [1, 10], line=True))), PALETTE[0])[1]
    bars = drawn(chart(Series("", [1, 10], [1, 10], spread=[(0.5, 2), (5, 20)])))
    assert line > 2 * bare
    assert centre(bars, PALETTE[0])[1] > 1.2 * bare


@pytest.mark.parametrize("marker", ["circle", "square", "triangle", "diamond"])
def test_markers(marker):
    assert centre(drawn(chart(Series("", [1], [1], marker=marker))), PALETTE[0])[1] > 15


def test_a_note_is_drawn():
    series = Series("", [1, 10], [1, 10])
    plain, ringed = chart(series), chart(series, notes=[Note(10, 10, "here")])
    a, b = (drawn(c).astype(int) for c in (plain, ringed))
    rows, _ = np.nonzero(np.abs(a - b).sum(-1) > 50)
    assert len(rows) > 100
    assert np.ptp(rows) < 60  # the ring and the words, in one place


def test_png():
    picture = Image.open(io.BytesIO(chart(Series("", [1], [1])).png()))
    assert picture.size == (1000, 620)


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_values_without_logarithm(bad):
    with pytest.raises(InputError, match="positive"):
        chart(Series("", [1, bad], [1, 1])).figure()


def test_no_points():
    with pytest.raises(InputError, match="positive"):
        chart().figure()


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(1e-5, "10 us"), (1e-3, "1 ms"), (0.5, "500 ms"), (1, "1 s"), (600, "10 min"), (7200, "2 h")],
)
def test_times_on_an_axis(seconds, text):
    assert time_text(seconds) == text


# --------------------------------------------------------------------------- what accuracy costs

WAYS = with_front(
    [
        Way("closed form", 0, "", "float64", forward=2, gradient=5, error=0.0, gradient_error=0.0,
            memory=3_000_000, reference=True),
        Way("closed form", 1e-2, "", "float32", forward=1, gradient=2, error=1e-3,
            gradient_error=1e-2),
        Way("particle-mesh", 1e-2, "degree 2", "float32", accuracy=1e-2, forward=0.01,
            gradient=0.02, error=2e-3, gradient_error=3e-2, in_use=True),
        Way("closed form", 1e-4, "", "float64", note="not measured: about 2 h"),
    ]
)  # fmt: skip


def test_table_of_ways():
    lines = ways_table(WAYS).splitlines()
    assert len(lines) == 5
    assert [line.index("float") > 0 for line in lines[1:]]
    assert "reference" in lines[1]
    assert "3 MB" in lines[1]
    assert lines[1].count(" - ") == 2  # it has no error of its own
    assert "asked 1e-2" in lines[3]
    assert "in use, front" in lines[3]
    assert lines[4].rstrip().endswith("not measured: about 2 h")
    column = lines[0].index("image error") + len("image error")
    assert lines[2][:column].endswith("1.0e-03")
    assert lines[3][:column].endswith("2.0e-03")


def test_chart_of_ways():
    drawn = ways_chart(WAYS, "A scene")
    names = [s.name for s in drawn.series]
    assert names == ["none faster and better", "closed form, float32", "as planned for an accuracy"]
    assert drawn.notes == [Note(0.02, 2e-3, "in use: 1e-2")]
    drawn.figure()


def errors(*means):
    dialled = [Dialled(edge, 1e-2, 0.02, 0.025) for edge in (0.9, 0.6, 0.3)]
    given = zip(SHAPE_CHOICES, dialled, means, (1, 2, 4), strict=True)
    return [ShapeError(c, d, (0.9 * m, m, 1.1 * m), 100.0, s) for c, d, m, s in given]


@pytest.mark.parametrize(
    ("means", "says"),
    [
        ((0.03, 0.0202, 0.02), "normal is the fastest"),
        ((0.0201, 0.02, 0.02), "quick is the fastest"),
        ((0.04, 0.03, 0.02), "careful is the fastest"),
    ],
)
def test_answer(means, says):
    assert says in shape_answer(errors(*means))
    assert "given this noise (3 draws)" in shape_answer(errors(*means))


def test_table_and_chart_of_shapes():
    found = errors(0.03, 0.0202, 0.02)
    lines = shape_table(found, 0.1).splitlines()
    assert len(lines) == 4
    assert lines[1].split()[:5] == ["quick", "25", "nm", "30", "nm"]
    assert "0.300 voxel" in lines[1]
    assert [line.endswith("enough") for line in lines] == [False, False, True, False]
    drawn = shape_chart(found, "Shapes")
    assert [note.text for note in drawn.notes] == list(SHAPE_CHOICES)
    assert drawn.series[0].y == pytest.approx([30, 20.2, 20])
    assert drawn.series[1].y == pytest.approx([25, 25, 25])
    drawn.figure()


def test_short_numbers():
    assert [short(a) for a in (0, 0.1, 1e-3, 2.5e-4)] == ["0 (exact)", "1e-1", "1e-3", "2.5e-4"]
