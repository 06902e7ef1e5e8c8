"""Numbers and lists in words for a reader."""

from __future__ import annotations

from collections.abc import Sequence


def scientific(value: float, digits: int = 3) -> str:
    """A number in short scientific notation: 1e-3 rather than 0.001 or 1e-03."""
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def readable(value: float, digits: int = 4) -> str:
    """A number with so many significant digits; no exponent up to a million."""
    short = f"{value:.{digits}g}"
    return f"{float(short):.0f}" if "e" in short and 1 < abs(value) < 1e6 else short


def duration(seconds: float, whole: bool = False) -> str:
    """A time in the unit that suits it; ``whole``: without decimals, as for a forecast."""
    digits = ".0f" if whole else ".2g"
    # Limits below which two digits in this unit tell more than two in the next.
    for limit, unit, size in ((9.95e-2, "ms", 1e-3), (90, "s", 1), (5400, "min", 60)):
        if seconds < limit:
            return f"{seconds / size:{digits}} {unit}"
    hours = seconds / 3600
    return f"{hours:{digits}} h" if hours < 48 else f"{hours / 24:.0f} days"


def sentence(text: str) -> str:
    """A phrase or question as a sentence: with a capital and, unless a question, a full stop."""
    return f"{text[0].upper()}{text[1:]}{'' if text.endswith('?') else '.'}" if text else ""


def joined(words: Sequence[str]) -> str:
    """Words as a list in a sentence: a, b and c."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def counted(n: int, thing: str) -> str:
    """A number with its noun, in the plural where needed: 1 cell, 2 cells, 3 vertices."""
    return f"{n} {thing}" if n == 1 else f"{n} {thing.replace('vertex', 'vertice')}s"
