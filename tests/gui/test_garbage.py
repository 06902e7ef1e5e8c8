"""Collections of garbage while the window has to answer."""

import gc

import pytest

from napari_deltamic.gui.calm import Calm


@pytest.fixture(autouse=True)
def thawed():
    gc.unfreeze()
    yield
    gc.unfreeze()


def test_what_was_there_is_left_out_until_the_last_one_ends():
    first, second = Calm(), Calm()
    first.begin()
    second.begin()
    assert gc.get_freeze_count() > 0
    first.end()
    assert gc.get_freeze_count() > 0
    second.end()
    assert gc.get_freeze_count() == 0


def test_what_a_program_froze_by_itself_stays_so():
    gc.freeze()
    calm = Calm()
    calm.begin()
    calm.end()
    assert gc.get_freeze_count() > 0
