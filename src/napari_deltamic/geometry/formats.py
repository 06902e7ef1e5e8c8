"""The table of mesh formats that readers, writers, dialogs, flags and the manifest go by.

It imports nothing heavy, so that the command line can list the formats at once. A format named
``ply`` is read and written by ``read_ply`` and ``write_ply`` of ``files/ply.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath


@dataclass(frozen=True)
class MeshFormat:
    """A kind of mesh file.

    Attributes
    ----------
    name
        Name of its module in ``files/``, and its suffix.
    title
        Name shown in dialogs.
    regions
        Whether it keeps the region pairs of faces.
    attributes
        Whether it can hold further numbers for each face.
    """

    name: str
    title: str
    regions: bool = True
    attributes: bool = False

    @property
    def suffix(self) -> str:
        """Suffix of its files, in lower case, with the dot."""
        return f".{self.name}"


# The first is what a dialog offers first.
MESH_FORMATS = (
    MeshFormat("ply", "PLY", attributes=True),
    MeshFormat("obj", "OBJ"),
    MeshFormat("off", "OFF", regions=False),
    MeshFormat("stl", "STL", regions=False),
    MeshFormat("rec", "multimaterial"),
    MeshFormat("vtk", "VTK", attributes=True),
)
MESH_FILES = tuple(one.suffix for one in MESH_FORMATS)
MESH_FILES_LISTED = f"{', '.join(MESH_FILES[:-1])} or {MESH_FILES[-1]}"  # in a sentence
# Filters of file dialogs: all at once, to open; one by one, to save.
MESH_FILTER = f"Meshes ({' '.join(f'*{suffix}' for suffix in MESH_FILES)})"
MESH_FILTERS = ";;".join(f"{one.title} (*{one.suffix})" for one in MESH_FORMATS)


def mesh_format(path: str | PurePath) -> MeshFormat | None:
    """Return the format of a file by its suffix; None if no mesh format has that suffix."""
    suffix = PurePath(path).suffix.lower()
    return next((one for one in MESH_FORMATS if one.suffix == suffix), None)
