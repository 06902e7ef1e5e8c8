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


def test_short_names_lie_in_the_folder_named_before_them():
    page = ROOT / "CONTRIBUTING.md"
    if not page.exists():
        pytest.skip("not in a source tree")
    table = page.read_text().split("## Where to change what")[1].split("\n## ")[0]
    missing, seen = [], 0
    for row in table.splitlines():
        folder = None
        for place in re.findall(r"`([^`]+)`", row):
            if "/" in place:
                folder = place.rpartition("/")[0]
            elif place.endswith(".py"):
                seen += 1
                here = folder is not None and "NAME" not in place
                if here and not (ROOT / "src" / "napari_deltamic" / folder / place).exists():
                    missing.append(f"{folder}/{place}")
    assert seen > 20
    assert missing == []
