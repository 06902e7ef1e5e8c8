"""When one answer surely explains more than another."""

from types import SimpleNamespace

import numpy as np
import pytest

from napari_deltamic.fitting.rival_structures import RULES, _explains_more


def answer(gains, asked="auto"):
    """One that explains so many nats more in each block, whichever way insides are measured."""
    settings = SimpleNamespace(structure=asked)
    return SimpleNamespace(
        terms=SimpleNamespace(settings=settings),
        nats_over=lambda other, evened: np.asarray(gains[evened], float),
    )


def compared(evened, measured, asked="auto"):
    gains = {True: np.asarray(evened), False: np.asarray(measured)}
    losses = {k: -g for k, g in gains.items()}
    return _explains_more(answer(gains, asked), answer(losses, asked))


EVERYWHERE = np.full(100, 1.0)
IN_ONE_PLACE = np.concatenate([[100.0], np.zeros(99)])


@pytest.mark.parametrize(
    ("evened", "measured", "more"),
    [
        (EVERYWHERE, EVERYWHERE, True),
        (EVERYWHERE, IN_ONE_PLACE, False),  # 100 nats, with an error of 100
        (IN_ONE_PLACE, EVERYWHERE, False),
        (EVERYWHERE, -EVERYWHERE, False),
        (0.1 * EVERYWHERE, EVERYWHERE, False),  # 10 nats
    ],
)
def test_it_must_explain_more_all_over_and_either_way(evened, measured, more):
    assert compared(evened, measured) is more


def test_where_both_are_asked_for_one_place_is_enough():
    assert compared(IN_ONE_PLACE, IN_ONE_PLACE, "both")
    assert not compared(0.1 * IN_ONE_PLACE, IN_ONE_PLACE, "both")


def test_the_bound_is_what_a_membrane_must_differ_by():
    just = (RULES.nats + 0.1) / 100 * EVERYWHERE
    assert compared(just, just)
    assert not compared(just - 0.002, just)
