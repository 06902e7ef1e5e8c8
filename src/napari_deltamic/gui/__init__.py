"""What napari users see: panels, the viewer link, and the worker that runs a fit."""

import re
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

from ..errors import InputError

# napari 0.6 fails when the dock is opened; 0.7.0 loses layers that come while others go.
OLDEST = (0, 7, 1)


def check_napari(found: str) -> None:
    """Raise InputError, with what to do, if this version of napari is too old for the widget."""
    # The version of napari from a source tree may be anything.
    numbers = tuple(int(word) for word in re.findall(r"^\d+|(?<=\.)\d+", found.split("+")[0])[:3])
    if len(numbers) > 1 and numbers < OLDEST[: len(numbers)]:
        oldest = ".".join(map(str, OLDEST))
        raise InputError(
            f"deltaMic needs napari {oldest} or newer, and this is {found}: "
            "pip install --upgrade napari"
        )


with suppress(PackageNotFoundError):
    check_napari(version("napari"))
