"""The description of each setting, written once: flags, forms and reference page are made from it.

A settings object names, for each of its fields, a title, a unit, a tip, bounds, whether it is for
experts, whether a running fit adopts a change of it, and its flag. :func:`setting` declares that
together with the field, and :func:`described` reads it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import Field
from pydantic.fields import FieldInfo

from .words import sentence

Kind = Literal["switch", "choice", "whole", "number", "triple", "numbers", "text", "part"]
_KEY = "setting"


@dataclass(frozen=True)
class Described:
    """All that is known about one setting.

    Attributes
    ----------
    name
        The name of its field.
    title
        What a form calls it, in a few words.
    tip
        What it does, in a sentence or two, without a full stop.
    unit
        Unit of its numbers; "" for none.
    kind
        What it holds: a switch (yes or no), a choice of names, a whole number, a number, three
        numbers (Z, Y, X), any number of numbers, a text, or a part, which has settings of its own.
    choices
        For a choice, its names; for a text, the known values.
    words
        What a form calls those choices whose names do not explain themselves.
    low, high
        Bounds of a number; None where there is none.
    optional
        Whether it may be left open (None).
    default
        None where it is open, or where it must be given.
    required
        Whether it must be given.
    advanced
        Whether it is for experts, or rarely useful.
    live
        Whether a running fit adopts a change of it.
    flag
        Its flag on the command line; "" where there is none.
    metavar
        What the flag's help calls a value.
    start
        What a form shows where the default is open.
    step
        The step by which a form changes a number.
    automatic
        What a form calls a value that is left open.
    """

    name: str
    title: str
    tip: str
    unit: str
    kind: Kind
    choices: tuple[str, ...]
    low: float | None
    high: float | None
    optional: bool
    default: Any
    required: bool
    advanced: bool
    live: bool
    flag: str
    metavar: str
    start: float | None
    step: float
    automatic: str
    words: Mapping[str, str]

    @property
    def label(self) -> str:
        """The title with the unit."""
        return f"{self.title}, {self.unit}" if self.unit else self.title

    @property
    def sentence(self) -> str:
        """The tip as a sentence."""
        return sentence(self.tip)

    @property
    def bounds(self) -> str:
        """The bounds of a number in words; "" where there are none."""
        if self.low is not None and self.high is not None:
            return f"{self.low:g} to {self.high:g}"
        if self.low is not None:
            return f"at least {self.low:g}"
        return "" if self.high is None else f"at most {self.high:g}"


def setting(
    default: Any = ...,
    *,
    title: str,
    tip: str,
    unit: str = "",
    advanced: bool = False,
    live: bool = False,
    flag: str | None = "",
    metavar: str = "",
    known: Iterable[str] = (),
    start: float | None = None,
    step: float = 0.0,
    automatic: str = "automatic",
    words: Mapping[str, str] | None = None,
    **bounds: Any,
) -> Any:
    """A field of a settings object, with its description; see :class:`Described`.

    flag : "" for the flag made from the field's name, None for no flag.
    known : values that are offered for a text.
    bounds : ``ge``, ``gt``, ``le`` or ``lt``, as pydantic takes them.
    """
    extra: Any = {
        "unit": unit,
        "advanced": advanced,
        "live": live,
        "flag": flag,
        "metavar": metavar,
        "known": tuple(known),
        "start": start,
        "step": step,
        "automatic": automatic,
        "words": words or {},
    }
    return Field(default, title=title, description=tip, json_schema_extra={_KEY: extra}, **bounds)


def described(model: type[Any]) -> dict[str, Described]:
    """Description of each field of a settings class by name, in order; only described fields."""
    found = {}
    for name, field in model.model_fields.items():
        said = _said(model, name)
        if said is not None:
            found[name] = _described(name, field, said)
    return found


def _said(model: type[Any], name: str) -> FieldInfo | None:
    """The field as described in the class itself or its nearest base class; None if nowhere."""
    for one in model.__mro__:
        field: FieldInfo | None = getattr(one, "model_fields", {}).get(name)
        if field is not None and _KEY in _extra(field):
            return field
    return None


def _extra(field: FieldInfo) -> dict[str, Any]:
    extra: Any = field.json_schema_extra
    return extra if isinstance(extra, dict) else {}


def _described(name: str, field: FieldInfo, said: FieldInfo) -> Described:
    extra = _extra(said)[_KEY]
    kind, names, optional = _kind(field.annotation)
    low, high = _bounds(field.metadata)
    required = field.is_required()
    default = None if required else field.get_default(call_default_factory=True)
    flag = extra["flag"]
    return Described(
        name=name,
        title=str(said.title),
        tip=str(said.description),
        unit=extra["unit"],
        kind=kind,
        choices=names or extra["known"],
        low=low,
        high=high,
        optional=optional,
        default=default,
        required=required,
        advanced=extra["advanced"],
        live=extra["live"],
        flag="" if flag is None else flag or f"--{name.replace('_', '-')}",
        metavar=extra["metavar"] or name[0].upper(),
        start=extra["start"],
        step=extra["step"],
        automatic=extra["automatic"],
        words=extra["words"],
    )


def _kind(annotation: Any) -> tuple[Kind, tuple[str, ...], bool]:
    """The kind of a type's values, the names to choose from, and whether None is allowed."""
    of = get_origin(annotation)
    if of is Annotated:
        return _kind(get_args(annotation)[0])
    if of in (Union, UnionType):
        parts = [part for part in get_args(annotation) if part is not NoneType]
        optional = len(parts) < len(get_args(annotation))
        kind, names, _ = _kind(parts[0]) if len(parts) == 1 else ("text", (), False)
        if len(parts) > 1 and not {*parts} <= {int, float, str}:
            kind = "part"
        return kind, names, optional
    if of is Literal:
        return "choice", tuple(map(str, get_args(annotation))), False
    if of is tuple:
        inner = get_args(annotation)
        numbers = all(_kind(part)[0] == "number" for part in inner if part is not Ellipsis)
        kinds: Kind = "triple" if len(inner) == 3 else "numbers"
        return kinds if numbers else "part", (), False
    plain: dict[Any, Kind] = {bool: "switch", int: "whole", float: "number", str: "text"}
    return plain.get(annotation, "part"), (), False


def _bounds(metadata: Iterable[Any]) -> tuple[float | None, float | None]:
    low = high = None
    for limit in metadata:
        low = getattr(limit, "ge", getattr(limit, "gt", low))
        high = getattr(limit, "le", getattr(limit, "lt", high))
    return low, high
