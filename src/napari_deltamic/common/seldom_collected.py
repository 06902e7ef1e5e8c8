"""How often a process that runs one command looks for objects that refer to each other.

By default Python looks after every 700 new ones; the engine's modules alone make 290,000 that
stay. Measured on four fits of a second each by one process, loading included, four times in turn:
6.8 to 7.8 s instead of 7.0 to 9.2 (medians 7.3 and 7.5). What such objects hold waits longer until
it is freed.
"""

import gc

_MADE = 50_000  # objects between two looks; chosen: a look is then rare beside what a fit makes


def collect_seldom() -> None:
    """Look seldom from now on."""
    gc.set_threshold(_MADE)


def dask_setup(worker: object) -> None:
    """The same in a process that Dask starts for us, which calls this."""
    collect_seldom()
