"""What CONTRIBUTING says of places is so."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_every_place_that_it_names_is_there():
    page = ROOT / "CONTRIBUTING.md"
    if not page.exists():
        pytest.skip("not in a source tree")
    table = page.read_text().split("## Where to change what")[1].split("\n## ")[0]
    cells = re.findall(r"`([^`]+)`", table)
    places = [cell for cell in cells if "/" in cell and "NAME" not in cell]
    assert len(places) > 40
    package = ROOT / "src" / "napari_deltamic"
    missing = [p for p in places if not [*package.glob(p), *ROOT.glob(p)]]
    assert missing == []
