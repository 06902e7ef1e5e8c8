"""The compiled extension for meshes and stacks: remeshing, contacts, distances, blurs."""

from __future__ import annotations

from types import ModuleType


def native() -> ModuleType | None:
    """Return the compiled extension, or None where it is missing."""
    try:
        from . import _remesh  # type: ignore[attr-defined]
    except ImportError:
        return None
    return _remesh
