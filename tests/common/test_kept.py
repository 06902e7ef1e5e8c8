"""Results that are kept: the last few, for several threads; or all that a method returned."""

from concurrent.futures import ThreadPoolExecutor

from napari_deltamic.common.kept import Kept, kept


def test_threads_share_what_is_kept():
    kept, made = Kept(3), []

    def ask(first):
        for i in range(300):
            key = (first + i // 50) % 5
            assert kept.get(key, lambda key=key: made.append(key) or [key]) == [key]

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(ask, range(4)))
    assert len(kept) == 3
    assert len(made) < 1200


class Squares:
    def __init__(self):
        self.asked = []

    @kept
    def of(self, number):
        self.asked.append(number)
        return number**2


def test_a_method_keeps_what_it_returns_for_each_object():
    one, other = Squares(), Squares()
    assert [one.of(k) for k in (2, 3, 2, 3)] == [4, 9, 4, 9]
    assert other.of(2) == 4
    assert (one.asked, other.asked) == ([2, 3], [2])
