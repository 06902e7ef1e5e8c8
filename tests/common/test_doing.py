"""What a long computation is at, and who hears of it."""

import pytest

from napari_deltamic.common.doing import doing, heard, listening


def test_nobody_has_to_listen():
    doing("nothing")


def test_what_is_done_to_make_each_item_is_heard():
    told = []

    def items():
        for k in range(3):
            doing(f"making {k}")
            yield k

    made = heard(items(), told.append)
    assert next(made) == 0
    doing("elsewhere")  # between two items, somebody else works
    assert list(made) == [1, 2]
    assert told == ["making 0", "making 1", "making 2"]


def test_who_listens_may_end_it():
    def stop(what):
        raise RuntimeError(what)

    def items():
        yield 1
        doing("too long")
        yield 2

    made = heard(items(), stop)
    assert next(made) == 1
    with pytest.raises(RuntimeError, match="too long"):
        next(made)
    told = []
    with listening(told.append):
        doing("another")
    assert told == ["another"]
