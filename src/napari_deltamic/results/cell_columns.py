"""The columns of the table of cells: those of the measurements, as they are shown to a user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from ..common.table import Column
from ..common.words import readable
from ..measure.all_cells import CELL_COLUMNS

_SUFFIX = {"um^3": "_um3", "um^2": "_um2", "um": "_um", "1/um": "_per_um"}
_TITLES = {
    "region": "cell",
    "residual_z": "misfit",
    "cut_by_border": "cut",
    "n_contacts": "contacts",
    "gaussian_curvature_integral": "Gaussian curvature integral",
}
_SHARES = ("explained",)
_ERROR_DIGITS = 2  # errors are not known more precisely
# The columns that are shown until the user chooses others.
FIRST = (
    "region",
    "volume_um3",
    "area_um2",
    "sphericity",
    "explained",
    "shape_error_um",
    "grade",
)
_RESIDUAL = Column(
    "residual_z",
    "standard deviations by which the difference near the cell is larger than noise",
)


@dataclass(frozen=True)
class CellColumn:
    """A column as it is shown in the table.

    key : of its values in the rows.
    title : its name, with the unit on a line of its own.
    tip : a sentence that says what it holds.
    """

    key: str
    title: str
    tip: str

    @property
    def name(self) -> str:
        """The title on one line."""
        return self.title.replace("\n", ", ")

    def text(self, value: Any) -> str:
        """Return a value as it is shown; '-' for none."""
        if isinstance(value, str):
            return value
        if not is_number(value):
            return "-"
        if self.key == "region" or isinstance(value, int):
            return f"{value:.0f}"
        if self.key in _SHARES:
            return f"{value:.1%}"
        return readable(value, _ERROR_DIGITS if self._is_error else 4)

    @property
    def _is_error(self) -> bool:
        return "error" in self.key or "_se" in self.key


def is_number(value: Any) -> bool:
    """Whether a value is a number, which can be sorted and plotted."""
    return isinstance(value, int | float) and isfinite(value)


def value_of(row: Mapping[str, Any], key: str) -> Any:
    """Return the value of a row in a column; None if it has none."""
    value = row.get(key)
    return None if isinstance(value, float) and not isfinite(value) else value


def _shown(column: Column) -> CellColumn:
    plain = column.name.removesuffix(_SUFFIX.get(column.unit, ""))
    title = _TITLES.get(column.name, plain.replace("_", " "))
    unit = column.unit.replace("um", "µm").replace("^3", "³").replace("^2", "²")
    tip = f"{column.meaning[0].upper()}{column.meaning[1:]}."
    return CellColumn(column.name, f"{title}\n{unit}" if unit else title, tip)


def columns_in(length: str) -> tuple[CellColumn, ...]:
    """Return all columns, titled for lengths in µm, or in voxels if their size is not known."""
    return tuple(replace(one, title=one.title.replace("µm", length)) for one in COLUMNS)


COLUMNS = tuple(_shown(column) for column in (*CELL_COLUMNS, _RESIDUAL))
