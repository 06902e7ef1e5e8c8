"""What pydantic finds wrong with a value, in the words of this package."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

_PLAIN = {
    "extra_forbidden": "there is no such setting",
    "missing": "it must be given",
    "tuple_type": "a list is needed, in [ ]",
    "dict_type": "a table is needed",
    "model_type": "a table is needed",
}


def first_wrong_value(error: ValidationError, *, skip: int = 0) -> str:
    """One line on the first wrong value: where it is, and what is wrong with it.

    Parameters
    ----------
    skip : how many leading names of its location to leave out.
    """
    # A misspelt name explains why the right one is missing, so it comes first.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    where = ".".join(str(part) for part in first["loc"][skip:])
    reason = _PLAIN.get(first["type"], str(first["msg"]))
    if first["type"] in ("union_tag_invalid", "union_tag_not_found"):
        context = first.get("ctx", {})
        name = str(context.get("discriminator", "kind")).strip("'")
        reason = f"it must say its {name}"
        if "tag" in context:
            reason = f"{name} {context['tag']!r} is none of {context['expected_tags']}"
    reason = reason.removeprefix("Value error, ").replace("Input should be", "it must be")
    return f"{where}: {reason}" if where else reason
