"""TOML documents; an array, or a table within a table, is written on one line."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from ..errors import InputError


def toml_document(values: Mapping[str, Any]) -> str:
    """Plain values as a TOML document; None is left out.

    Raises InputError for a text that no file can hold.
    """
    parts = {name: value for name, value in values.items() if _is_table(value)}
    text = _lines({name: value for name, value in values.items() if name not in parts})
    for name, part in parts.items():
        one = isinstance(part, dict)
        head = f"[{name}]" if one else f"[[{name}]]"
        text += "".join(f"\n{head}\n{_lines(table)}" for table in ([part] if one else part))
    return text


def _is_table(value: Any) -> bool:
    """Whether a value is a table, or a list of tables."""
    return isinstance(value, dict) or (
        isinstance(value, (list, tuple)) and any(isinstance(one, dict) for one in value)
    )


def _lines(values: Mapping[str, Any]) -> str:
    return "".join(f"{k} = {_value(v)}\n" for k, v in values.items() if v is not None)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        if not value.isprintable() and any("\ud800" <= c <= "\udfff" for c in value):
            raise InputError(f"{value!r} is not a name that a text file can hold: rename it")
        # TOML's basic strings escape as JSON's do, and also the delete character.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_value(str(k))} = {_value(v)}" for k, v in value.items()) + "}"
    return "[" + ", ".join(_value(v) for v in value) + "]"
