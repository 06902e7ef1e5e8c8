"""How long fits take is learned, and kept on disk."""

import pytest

from napari_deltamic.accuracy.experience import Experience, Learned


def test_the_speed_of_the_first_fit_counts_alone_and_of_later_ones_half(tmp_path):
    learned = Learned(tmp_path)
    assert learned.about("foam") == Experience()
    learned.learn("foam", Experience(4.0, 0.5))
    assert learned.about("foam").seconds == pytest.approx(4.0)
    assert learned.about("foam").iterations == pytest.approx(0.5**0.25)
    learned.learn("foam", Experience(1.0, 2.0))
    assert learned.about("foam").seconds == pytest.approx(2.0)  # in the middle, as factors go
    assert learned.about("foam").iterations == pytest.approx(0.5 ** (0.75 * 0.25) * 2.0**0.25)


def test_of_a_kind_that_is_new_the_speed_is_known(tmp_path):
    learned = Learned(tmp_path)
    learned.learn("foam", Experience(3.0, 0.2))
    other = learned.about("vesicles")
    assert other.seconds == pytest.approx(3.0)
    assert other.iterations == 1.0


def test_another_region_of_an_image_is_like_it(tmp_path):
    learned = Learned(tmp_path)
    learned.learn("foam", Experience(3.0, 12.0, single=True), ("nuclei", "left"))
    learned.learn("foam", Experience(2.0, 1.0), ("foam", "all"))
    for region in ("left", "right"):
        assert learned.about("foam", ("nuclei", region)) == Experience(3.0, 12.0, single=True)
    other = learned.about("foam", ("others", "right"))
    assert other.iterations < 2
    assert not other.single, "of an image that was never fitted less is known"


def test_it_is_kept(tmp_path):
    Learned(tmp_path).learn("foam", Experience(3.0, 0.2))
    assert Learned(tmp_path).about("foam").seconds == pytest.approx(3.0)


@pytest.mark.parametrize(
    "text", ["", "[1]", '{"foam": 3}', '{"foam": [1, 2]}', '{"foam": [1e999, 0, 1]}']
)
def test_what_cannot_be_read_is_nothing(tmp_path, text):
    (tmp_path / "fits.json").write_text(text)
    learned = Learned(tmp_path)
    assert learned.about("foam") == Experience()
    learned.learn("foam", Experience(2.0, 1.0))
    assert Learned(tmp_path).about("foam").seconds == pytest.approx(2.0)


def test_a_folder_that_cannot_be_written_to_costs_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    learned = Learned(tmp_path / "file")
    learned.learn("foam", Experience(2.0, 1.0))
    assert learned.about("foam").seconds == pytest.approx(2.0)
