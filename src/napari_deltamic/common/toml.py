"""Values as TOML writes them."""

from __future__ import annotations

import json
from typing import Any

from ..errors import InputError


def toml_value(value: Any) -> str:
    """A value as TOML writes it. Raises InputError for a text that no file can hold."""
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
        return (
            "{"
            + ", ".join(f"{toml_value(str(k))} = {toml_value(v)}" for k, v in value.items())
            + "}"
        )
    return "[" + ", ".join(toml_value(v) for v in value) + "]"
