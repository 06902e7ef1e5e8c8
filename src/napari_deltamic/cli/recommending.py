"""Recommended effects on the command line: as lines, as a table, as plain values."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ..common.table import aligned
from ..evidence import Recommendation, Residual
from ..evidence.camera import Camera

_HEADINGS = ("effect", "score", "bias (nm)", "cost (ms)", "", "why")


def verdict(found: Recommendation) -> list[str]:
    """A line for each recommended effect, or one that says there is none; then any remarks."""
    lines = [f"effects: {e.name} added: {e.reason}" for e in found.evidence if e.recommended]
    lines = lines or ["effects: the image calls for none"]
    return [*lines, *(f"effects: {remark}" for remark in found.remarks)]


def as_table(found: Recommendation) -> str:
    """A table in aligned columns with a line for every effect that was considered."""
    rows = [
        (
            e.name,
            f"{e.score:.1f}",
            f"{e.bias_nm:.2g}" if e.bias_nm < 10 else f"{e.bias_nm:.0f}",
            f"{e.cost_ms:.1f}",
            "take" if e.recommended else "",
            e.reason,
        )
        for e in found.evidence
    ]
    return aligned([_HEADINGS, *rows], left=(0, 4, 5))


def as_plain(found: Recommendation) -> dict[str, Any]:
    """The recommendation as plain values, for JSON."""
    return {
        "recommended": list(found.recommended),
        "threshold": found.threshold,
        "effects": found.effects.to_dict(),
        "remarks": list(found.remarks),
        "evidence": [asdict(e) for e in found.evidence],
        "camera": camera_as_plain(found.camera),
    }


def residual_as_plain(left: Residual) -> dict[str, Any]:
    """The residual as plain values, for JSON, without its map."""
    return {
        "explained": left.explained,
        "threshold": left.threshold,
        "cells": [asdict(c) for c in left.cells],
        "spots": [asdict(s) for s in left.spots],
    }


def camera_as_plain(camera: Camera) -> dict[str, Any]:
    """Gain, read noise, offset and saturation for JSON: value, error, how each was found."""
    findings = ("gain", "read_noise", "offset", "saturation")
    return {name: asdict(getattr(camera, name)) for name in findings}
