"""What is left out is told in a line, each reason once."""

import pytest

from napari_deltamic import InputError
from napari_deltamic.geometry.refused import told


def test_seeds_that_share_a_reason_are_listed():
    small = [f"label {k} is too small" for k in (3, 5, 8)]
    text = told([*small, "label 4 lies elsewhere"], 9, "label")
    assert text == (
        "4 of 9 labels are left out: label 3 is too small, likewise 5 and 8; label 4 lies elsewhere"
    )


def test_a_long_list_ends_with_a_number():
    text = told([f"label {k} is too small" for k in range(1, 31)], 40, "label")
    assert text.endswith(
        "label 1 is too small, likewise 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13 and 17 more"
    )


def test_sentences_of_two_points_stay_apart():
    both = ["point 2 is in the same cell as point 1", "point 4 is in the same cell as point 3"]
    assert told(both, 5, "point") == f"2 of 5 points are left out: {'; '.join(both)}"


def test_none_left_is_an_error():
    with pytest.raises(InputError, match="label 1 is too small, likewise 2"):
        told(["label 1 is too small", "label 2 is too small"], 2, "label")
