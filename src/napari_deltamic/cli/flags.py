"""Flags made from the descriptions of settings, and the values given with them."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Mapping
from typing import Any

from ..common.description import Described, described

TRIPLE = ("Z", "Y", "X")


def add_flags(
    parser: Any,
    model: type[Any],
    names: Collection[str] | None = None,
    *,
    required: Collection[str] = (),
    helps: Mapping[str, str] | None = None,
) -> None:
    """Add a flag for each setting that has one, without a default: the settings object has that.

    Parameters
    ----------
    parser : an argparse parser, or a group of one.
    model : a settings class.
    names : the settings to add, by name; None for all.
    required : names of those that must be given.
    helps : help texts to use instead of the tips, by name.
    """
    for name, found in described(model).items():
        if found.flag and (names is None or name in names):
            text = (helps or {}).get(name) or help_of(found)
            parser.add_argument(
                found.flag,
                help=text.replace("%", "%%"),
                required=name in required,
                **_how(found),
            )


def help_of(found: Described) -> str:
    """The help text of a flag: unit, what it does, default."""
    text = f"{found.unit}; {found.tip}" if found.unit else found.tip
    if found.required or found.default is None or found.kind == "part":
        return text
    return f"{text} (default: {found.default})"


def values_given(
    arguments: argparse.Namespace, model: type[Any], names: Collection[str] | None = None
) -> dict[str, Any]:
    """The settings given by the arguments, by name, as plain values."""
    found = {}
    for name, one in described(model).items():
        if one.flag and (names is None or name in names):
            value = getattr(arguments, dest_of(one), None)
            if value is not None:
                found[name] = value
    return found


def dest_of(found: Described) -> str:
    """The attribute under which argparse stores the value of a flag."""
    return found.flag.lstrip("-").replace("-", "_")


def _how(found: Described) -> dict[str, Any]:
    if found.kind == "switch":
        return {"action": argparse.BooleanOptionalAction, "default": None}
    if found.kind == "choice":
        return {"choices": found.choices}
    if found.kind == "triple":
        return {"nargs": 3, "type": float, "metavar": TRIPLE}
    if found.kind == "numbers":
        return {"nargs": "+", "type": float, "metavar": found.metavar}
    if found.kind == "text" and found.choices:
        return {"type": _number_or_text, "metavar": found.metavar}
    kinds: dict[str, Any] = {"whole": int, "number": float}
    return {"type": kinds.get(found.kind, str), "metavar": found.metavar}


def _number_or_text(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text
