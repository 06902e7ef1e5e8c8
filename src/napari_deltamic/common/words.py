"""Numbers as they are read."""

from __future__ import annotations

from collections.abc import Sequence


def scientific(value: float, digits: int = 3) -> str:
    """1e-3 rather than 0.001 or 1e-03, of at most so many digits."""
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def readable(value: float, digits: int = 4) -> str:
    """A number of so many digits, up to a million without an exponent."""
    short = f"{value:.{digits}g}"
    return f"{float(short):.0f}" if "e" in short and 1 < abs(value) < 1e6 else short


def duration(seconds: float, whole: bool = False) -> str:
    """A time in words that fit a table; ``whole``: no more exact than a forecast can be."""
    digits = ".0f" if whole else ".2g"
    # Limits below which two digits of the unit tell more than those of the next one would.
    for limit, unit, size in ((9.95e-2, "ms", 1e-3), (90, "s", 1), (5400, "min", 60)):
        if seconds < limit:
            return f"{seconds / size:{digits}} {unit}"
    hours = seconds / 3600
    return f"{hours:{digits}} h" if hours < 48 else f"{hours / 24:.0f} days"


def sentence(text: str) -> str:
    """A reason, or a question, as a sentence."""
    return f"{text[0].upper()}{text[1:]}{'' if text.endswith('?') else '.'}" if text else ""


def joined(words: Sequence[str]) -> str:
    """Words as they are read out: a, b and c."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def counted(n: int, thing: str) -> str:
    """So many of a thing: 1 cell, 2 cells, 3 vertices."""
    return f"{n} {thing}" if n == 1 else f"{n} {thing.replace('vertex', 'vertice')}s"
