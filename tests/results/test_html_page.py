"""The page about a result: whole, well formed, escaped, the same each time."""

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from benchmarks.double_bubble import DoubleBubble
from PIL import Image

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import Known, measure
from napari_deltamic.results.html_page import html_page
from napari_deltamic.results.measured_source import Measurable

GRID = nd.Grid((20, 30, 36), (0.5, 0.4, 0.4))
VOID = {"meta", "img", "br", "rect"}


class Checker(HTMLParser):
    """Every tag that opens closes, in order."""

    def __init__(self):
        super().__init__()
        self.open, self.words = [], []

    def handle_starttag(self, tag, attributes):
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attributes:
            assert name not in ("href",), "no other file is needed"
            assert name != "src" or value.startswith("data:")

    def handle_endtag(self, tag):
        assert tag in VOID or self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def words_of(page):
    checker = Checker()
    checker.feed(page)
    assert checker.open == []
    return " ".join(checker.words)


@pytest.fixture(scope="module")
def source():
    mesh = DoubleBubble(2.0, (1.0, 0.9, 1.2)).mesh(0.6).translated((5, 6, 7))
    image = nd.render(mesh, GRID, nd.GaussianPSF((0.6, 0.5, 0.5))).numpy()
    facts = {
        "converged": True,
        "iterations": 12,
        "warnings": ["the image is <dim>"],
        "settings": {"image": "a & b.tif"},
        "verdict": {"grade": "fair", "reasons": ["cell <2> is fair"]},
    }
    known = Known(grid=GRID, explained={1: 0.75, 2: 0.85})
    return Measurable("cells <1>", mesh, known, GRID, image, image, None, facts, ("mind this",))


def test_it_says_all_that_matters(source):
    page = html_page(source, measure(source.mesh, source.known))
    words = words_of(page)
    for part in (
        "Measurements of cells <1>", "2 cells, 3 walls, 1 junctions", "converged (12 iterations)",
        "explains 80 %", "shapes: fair: cell <2> is fair", "mind this",
        "the image is <dim>", "a & b.tif", "volume, µm³", "angles at junctions", "tension",
        "Versions", "torch", "How to cite", "Ichbiah",
    ):  # fmt: skip
        assert part in words, part
    assert "cells <1>" not in page  # escaped
    assert page == html_page(source, measure(source.mesh, source.known))


def test_the_picture_shows_both_images(source):
    page = html_page(source, measure(source.mesh))
    (data,) = re.findall(r"base64,([^\"]+)", page)
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))
    upper, lower = np.array_split(picture, 2)
    assert upper.std() > 10
    assert lower.std() > 10


def test_histograms_count_every_value(source):
    page = html_page(source, measure(source.mesh))
    sums = dict(re.findall(r"<figcaption>([^<]+)<br>median [^,]+, (\d+) values", page))
    assert sums["volume, µm³"] == "2"
    assert sums["area of a wall, µm²"] == "3"
    assert sums["angles at junctions, degrees"] == "3"


def test_a_mesh_alone_has_a_page_too():
    ball = sphere((1, 1, 1), 1.0)
    plain = Measurable("ball.ply", ball, Known(), remarks=("no image",))
    words = words_of(html_page(plain, measure(ball)))
    assert "There are none." in words  # junctions
    assert "no image" in words
    assert "Settings" not in words


def test_many_rows_are_cut_short():
    balls = nd.Mesh.merge([sphere((0, 0, 3.0 * k), 1.0, subdivisions=0) for k in range(203)])
    words = words_of(html_page(Measurable("b", balls, Known()), measure(balls)))
    assert "3 more in cells.csv" in words
