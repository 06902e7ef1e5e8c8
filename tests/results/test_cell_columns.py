"""How values of the table of cells are shown."""

import pytest

from napari_deltamic.results.cell_columns import COLUMNS


@pytest.mark.parametrize(
    ("key", "value", "shown"),
    [
        ("volume_um3", 12.34567, "12.35"),
        ("volume_um3", 12514.7, "12510"),
        ("volume_um3", 1.25147e7, "1.251e+07"),
        ("shape_error_um", 0.0055289, "0.0055"),
        ("explained", 0.8776, "87.8%"),
        ("region", 3, "3"),
        ("grade", "fair", "fair"),
        ("volume_um3", float("nan"), "-"),
        ("volume_um3", None, "-"),
    ],
)
def test_errors_have_two_digits_and_others_four(key, value, shown):
    (column,) = [c for c in COLUMNS if c.key == key]
    assert column.text(value) == shown
