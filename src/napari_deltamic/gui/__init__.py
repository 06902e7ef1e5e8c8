"""What napari users see: panels, the viewer link, and the worker that runs a fit."""

from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

from ..errors import InputError

OLDEST = (0, 7)  # napari 0.6 fails, with a traceback, when the dock is opened


def check_napari(found: str) -> None:
    """InputError, with what to do, if a version of napari is too old for the widget."""
    # The version of napari from a source tree may be anything.
    numbers = tuple(int(word) for word in found.split(".")[:2] if word.isdigit())
    if len(numbers) == 2 and numbers < OLDEST:
        oldest = ".".join(map(str, OLDEST))
        raise InputError(
            f"deltaMic needs napari {oldest} or newer, and this is {found}: "
            "pip install --upgrade napari"
        )


with suppress(PackageNotFoundError):
    check_napari(version("napari"))
