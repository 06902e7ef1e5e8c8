"""Standard errors and biases of measured numbers.

A number measured on a fitted mesh has a random error from noise, and a bias from three things that
are the same in every image: roughness that noise leaves on the surface adds area, flat triangles
are not the curved surface, and the prior smooths. All are estimated on replicas of the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..common.table import Column, Row, Table, Value
from ..geometry.mesh import FloatArray, Mesh
from ..geometry.replicas import Replicas

Tables = tuple[Table, ...]


@dataclass(frozen=True)
class ErrorRules:
    """Numbers that decide how standard errors are estimated.

    share
        Error of a correction as a share of it. From ``benchmarks.measurements``: areas of tori, for
        which flat triangles are off by 1.6 %, came out right within 0.07 %.
    nearer
        Angles are read from arcs; those of this part of their reach say what the reach does to
        them, at rims that the blur has rounded above all. Measured on 16 double bubbles: angles
        were off by as much as the two readings differ (0.7 and 0.9 degrees rms at ratios up to
        1.4, 3.3 and 2.9 at 1.8).
    known
        Share of the replicas on which a number must be measurable to get an error: the spread of
        only those on which it happens to be would be too small.
    """

    share: float = 0.05
    nearer: float = 0.7
    known: float = 0.9


RULES = ErrorRules()


# Numbers of each table that have errors: parts of column names before and after "_se" and "_bias".
MEASURED: dict[str, tuple[tuple[str, str], ...]] = {
    "cells": (
        ("volume", "_um3"),
        ("area", "_um2"),
        ("sphericity", ""),
        ("mean_curvature", "_per_um"),
        ("pressure", "_per_um"),
    ),
    "walls": (("area", "_um2"), ("mean_curvature", "_per_um"), ("tension", "")),
    "junctions": (("angle_a", "_deg"), ("angle_b", "_deg"), ("angle_c", "_deg")),
}
_KEYS = ("region", "region_a", "region_b", "region_c")
# The error of flat triangles falls with the square of their edges, so the triangles of the smooth
# surface still have a part of it. Angles, and what follows from them, are measured on arcs.
_BY_EDGES = ("volume", "area", "sphericity", "mean_curvature")


def with_errors(
    tables: Sequence[Table],
    replicas: Replicas,
    measured: Callable[[Mesh, float], Sequence[Table]],
) -> Tables:
    """Add standard errors and biases to tables, and correct their numbers for the biases.

    Parameters
    ----------
    tables
        Tables measured on the fitted mesh.
    replicas
        Of the fit.
    measured
        Measures the same tables on any mesh of the same walls, with angles from arcs that use the
        given share of their reach.
    """
    told = _Told(tables)
    move = replicas.mesh.with_vertices
    now = told.numbers(tables)
    settled, refitted, pulled = (
        told.numbers(measured(move(v), 1.0))
        for v in (replicas.settled, replicas.refitted, replicas.pulled)
    )
    flat = refitted - told.numbers(measured(replicas.smooth, 1.0))
    flat = np.where(told.by_edges, flat / (1 - 1 / replicas.finer), flat)
    ends = [[told.numbers(measured(mesh, 1.0)) for mesh in pair] for pair in replicas.pairs()]
    plus, minus = np.array(ends).transpose(1, 0, 2)
    with np.errstate(invalid="ignore"):
        odd, even = (plus - minus) / 2, (plus + minus) / 2 - now
        seen = np.isfinite(odd).mean(0) >= RULES.known
        scatter = np.sqrt(np.nanmean(np.where(seen, odd, 0.0) ** 2, axis=0))
        rough = np.nanmean(np.where(seen, even, 0.0), axis=0)
        bias = rough + flat + (pulled - refitted)
    # Where arcs are too short to measure anything, the effect of their reach is not known.
    rounded = np.nan_to_num(told.numbers(measured(replicas.mesh, RULES.nearer)) - now)
    # What more iterations would change is no bias: for a fit that was stopped it is only a guess.
    known = scatter**2 + (RULES.share * bias) ** 2
    error = np.sqrt(known + (settled - now) ** 2 + rounded**2)
    return told.filled(tables, np.where(seen, bias, np.nan), np.where(seen, error, np.nan))


def error_columns(table: str) -> tuple[Column, ...]:
    """Return the columns of standard errors and biases that a table of this name has."""
    found = []
    for name, unit in MEASURED[table]:
        words = name.replace("_", " ")
        off = f"bias of the {words} of the mesh, by which it was corrected"
        found += [
            Column(f"{name}_se{unit}", f"standard error of the {words}"),
            Column(f"{name}_bias{unit}", off),
        ]
    return tuple(found)


class _Told:
    """All numbers of some tables that have errors, as one array."""

    def __init__(self, tables: Sequence[Table]) -> None:
        self._at: dict[tuple[str, tuple[Value, ...], str, str], int] = {}
        for table in tables:
            for row in table.rows:
                for name, unit in MEASURED.get(table.name, ()):
                    self._at[(table.name, _key(row), name, unit)] = len(self._at)
        self.by_edges = np.array([name in _BY_EDGES for _, _, name, _ in self._at], bool)

    def numbers(self, tables: Sequence[Table]) -> FloatArray:
        """Return the numbers of tables, (N,); NaN for empty entries."""
        found = np.full(len(self._at), np.nan)
        for table in tables:
            for row in table.rows:
                for name, unit in MEASURED.get(table.name, ()):
                    value = row[name + unit]
                    at = self._at.get((table.name, _key(row), name, unit))
                    if at is not None and isinstance(value, float):
                        found[at] = value
        return found

    def filled(self, tables: Sequence[Table], bias: FloatArray, error: FloatArray) -> Tables:
        """Return tables corrected and with both columns; numbers without a known error stay."""
        found = []
        for table in tables:
            rows = []
            for row in table.rows:
                new = dict(row)
                for name, unit in MEASURED.get(table.name, ()):
                    at = self._at[(table.name, _key(row), name, unit)]
                    value = row[name + unit]
                    if not isinstance(value, float) or not np.isfinite(bias[at] + error[at]):
                        continue
                    new[name + unit] = value - float(bias[at])
                    new[f"{name}_bias{unit}"] = float(bias[at])
                    new[f"{name}_se{unit}"] = float(error[at])
                rows.append(new)
            found.append(replace(table, rows=tuple(rows)))
        return tuple(found)


def _key(row: Row) -> tuple[Value, ...]:
    return tuple(row[k] for k in _KEYS if k in row)
