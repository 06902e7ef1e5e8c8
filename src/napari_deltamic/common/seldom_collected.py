"""Rarer garbage collection in a process that runs one command.

By default Python collects after every 700 new objects; the engine's modules alone make 290,000 that
stay. Measured on four fits of a second each by one process, loading included, four times in turn:
6.8 to 7.8 s instead of 7.0 to 9.2 (medians 7.3 and 7.5). In exchange, what reference cycles hold is
freed later.
"""

import gc

_MADE = 50_000  # new objects between two collections; chosen: few beside all that a fit makes


def collect_seldom() -> None:
    """Collect garbage seldom from now on."""
    gc.set_threshold(_MADE)


def dask_setup(worker: object) -> None:
    """The same in a process that Dask starts; Dask calls this there."""
    collect_seldom()
