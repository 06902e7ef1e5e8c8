"""What a fit shows of itself, and what it keeps on disk."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.files import write_atomically
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene.effects import Effects


@dataclass(frozen=True)
class FitState:
    """One iteration of a fit; owns its arrays.

    Attributes
    ----------
    iteration, level, levels
        Count from 1; the level of the coarse-to-fine schedule and how many there are.
    mesh, optics
        As they are now.
    density
        (F,) fluorophores per um^2 relative to the mean.
    loss
        Weighted residual relative to the variance of the voxels that count: 1 explains nothing.
    amplitude, background
        Measured image = amplitude * rendered image + background.
    effects
        Optional parts of image formation, with their numbers as they are now.
    blur
        Width of both images at this level, in widths of the PSF.
    converged
        Whether this is the last state and the criterion was met.
    message
        A verdict or a warning in plain words; mostly empty.
    pinned
        (V,) bool: vertices that were told to stay; None where none were.
    events
        Changes of topology since the last state, a sentence each.
    """

    iteration: int
    level: int
    levels: int
    mesh: Mesh
    optics: Optics
    density: np.ndarray
    loss: float
    amplitude: float
    background: float
    blur: float
    effects: Effects = field(default_factory=Effects)
    converged: bool = False
    message: str = ""
    pinned: np.ndarray | None = None
    events: tuple[str, ...] = ()
    _render: Callable[[], np.ndarray] = field(repr=False, default=lambda: np.zeros(0))
    _checkpoint: Callable[[], dict[str, np.ndarray]] = field(repr=False, default=dict)

    @classmethod
    def late(cls, values: Callable[[], dict[str, Any]], **ready: Any) -> FitState:
        """A state of which some values stay on a device until one of them is asked for.

        ``values()`` gives those fields by name.
        """
        state = object.__new__(cls)
        for f in fields(cls):
            if f.default is not MISSING:
                state.__dict__[f.name] = f.default
            elif f.default_factory is not MISSING:
                state.__dict__[f.name] = f.default_factory()
        state.__dict__.update(ready, _late=values)
        return state

    def saying(self, message: str) -> FitState:
        """The same with another message."""
        other = object.__new__(FitState)
        other.__dict__.update(self.__dict__, message=message)
        return other

    def __getattr__(self, name: str) -> Any:
        # Called for what is not there yet, by several threads maybe.
        late = self.__dict__.get("_late")
        if name not in _FIELDS or (late is None and name not in self.__dict__):
            raise AttributeError(f"a FitState has no {name!r}")
        if late is not None:
            self.__dict__.update(late())
            self.__dict__.pop("_late", None)
        return self.__dict__[name]

    def rendered(self) -> np.ndarray:
        """(Z, Y, X) float32: what the microscope would show of this state; computed when asked."""
        return self._render()

    def save(self, path: str | Path) -> None:
        """Write a checkpoint that ``fit(..., resume=path)`` goes on from."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **self._checkpoint())  # type: ignore[arg-type]
        write_atomically(path, buffer.getvalue())


_FIELDS = frozenset(f.name for f in fields(FitState))


def load_checkpoint(path: str | Path) -> dict[str, np.ndarray]:
    """Read what :meth:`FitState.save` wrote.

    Raises
    ------
    InputError
        If the file is missing or no checkpoint.
    """
    try:
        # From memory: NumPy leaves a file that it cannot read open.
        file = np.load(io.BytesIO(Path(path).read_bytes()), allow_pickle=False)
        kept = {name: file[name] for name in file.files} if hasattr(file, "files") else {}
    except OSError as error:
        raise InputError(f"cannot read checkpoint {path}: {error}") from None
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        raise InputError(f"{path} is not a checkpoint, or a damaged one") from None
    if not {"vertices", "faces", "optics", "level"} <= set(kept):
        raise InputError(f"{path} is not a checkpoint of a fit")
    return kept
