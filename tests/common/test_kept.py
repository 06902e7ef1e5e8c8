"""Results that are kept: the last few, for several threads."""

from concurrent.futures import ThreadPoolExecutor

from napari_deltamic.common.kept import Kept


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
