"""The flags of a settings object, made of what it says of itself; and what was given by them."""

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
    """Add a flag for each setting that has one, without a default: the settings object has it.

    Parameters
    ----------
    parser : of argparse, or a group of one.
    model : a settings object.
    names : of its settings; None for all.
    required : names of those that have to be given.
    helps : other help texts, by name.
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
    """What a flag's help says: what it does, its unit, its default."""
    text = f"{found.unit}; {found.tip}" if found.unit else found.tip
    if found.required or found.default is None or found.kind == "part":
        return text
    return f"{text} (default: {found.default})"


def values_given(
    arguments: argparse.Namespace, model: type[Any], names: Collection[str] | None = None
) -> dict[str, Any]:
    """The settings that the arguments give, by name, as plain values."""
    found = {}
    for name, one in described(model).items():
        if one.flag and (names is None or name in names):
            value = getattr(arguments, dest_of(one), None)
            if value is not None:
                found[name] = value
    return found


def dest_of(found: Described) -> str:
    """The attribute that argparse gives to a flag."""
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
