"""Effects: optional parts of image formation, one class each; absent ones are not computed."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, model_validator

from ...common.wrong_value import first_wrong_value
from ...errors import InputError
from .base import (
    Cost,
    DepthEffect,
    Detection,
    DetectorEffect,
    Effect,
    FaceEffect,
    GainEffect,
    OffsetEffect,
    TransferEffect,
    Value,
    ViewEffect,
    VoxelEffect,
)
from .depth import Attenuation, Bleaching, DepthPSF
from .detection import Camera, Missing
from .optical import Halo, PixelIntegration
from .smooth import Background, Illumination
from .views import SecondView

E = TypeVar("E", bound=Effect)

KINDS: dict[str, type[Effect]] = {
    kind.name: kind
    for kind in (
        PixelIntegration,
        Background,
        Attenuation,
        Bleaching,
        Illumination,
        Halo,
        DepthPSF,
        Camera,
        Missing,
        SecondView,
    )
}
# Names that are no effects, and where they belong instead.
REFUSED = {
    "bulk": "light inside cells is part of what is labelled: use --structure both",
    "z_scale": "a factor on z is the same as another shape: correct the voxel size instead",
    "drift": "a drift from slice to slice is the same as another shape: register the stack before",
    "membrane_thickness": "a thick membrane is the same as a wider PSF: add it to sigma",
}


class Effects(BaseModel):
    """The effects of a scene; None where one is absent.

    ``Effects.of("halo", "bleaching")`` makes those with their defaults. Settings objects also
    accept a list of names, or a mapping of names to fields.

    Raises
    ------
    InputError
        By :meth:`of` and :meth:`replace`, if a name is unknown, or two effects are to be fitted
        that no image can tell apart.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    pixel_integration: PixelIntegration | None = Field(default=None)
    background: Background | None = Field(default=None)
    attenuation: Attenuation | None = Field(default=None)
    bleaching: Bleaching | None = Field(default=None)
    illumination: Illumination | None = Field(default=None)
    halo: Halo | None = Field(default=None)
    depth_psf: DepthPSF | None = Field(default=None)
    camera: Camera | None = Field(default=None)
    missing: Missing | None = Field(default=None)
    second_view: SecondView | None = Field(default=None)

    @model_validator(mode="before")
    @classmethod
    def _from_names(cls, values: Any) -> Any:
        if isinstance(values, (list, tuple)):
            values = {name: {} for name in values}
        if isinstance(values, Mapping):
            for name in values:
                check_name(str(name))
        return values

    @model_validator(mode="after")
    def _can_be_told_apart(self) -> Self:
        fitted = {effect.name for effect in self.present() if effect.fit}
        for effect in self.present():
            for other in effect.contradicts:
                if effect.fit and other in fitted:
                    raise ValueError(
                        f"no image tells {effect.name} from {other}: choose one, or hold one by "
                        "'fit = false'"
                    )
        return self

    @classmethod
    def of(cls, *chosen: str | Effect) -> Effects:
        """Return these effects; names stand for effects with their defaults."""
        found: dict[str, Any] = {}
        for effect in chosen:
            if isinstance(effect, Effect):
                found[effect.name] = effect
            else:
                found[effect] = {}
        return _made(cls, found)

    def present(self) -> tuple[Effect, ...]:
        """Return the present effects, in the order of the fields."""
        held = (getattr(self, name) for name in KINDS)
        return tuple(effect for effect in held if effect is not None)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the present effects."""
        return tuple(effect.name for effect in self.present())

    def role(self, kind: type[E]) -> E | None:
        """Return the present effect of a kind; None if there is none."""
        return next((effect for effect in self.present() if isinstance(effect, kind)), None)

    @property
    def detector(self) -> DetectorEffect | None:
        """The effect of the detector, if any."""
        return self.role(DetectorEffect)

    @property
    def depth(self) -> DepthEffect | None:
        """The effect by which the PSF changes with depth, if any."""
        return self.role(DepthEffect)

    @property
    def view(self) -> ViewEffect | None:
        """The effect that is a further image of the scene, if any."""
        return self.role(ViewEffect)

    @property
    def spread(self) -> float:
        """Distance (um) from the surface's own image within which voxels count due to effects."""
        return max((e.spread for e in self.present() if isinstance(e, TransferEffect)), default=0.0)

    def in_role(self, kind: type[Effect], effect: Effect | None) -> Effects:
        """Return the effects with this one as the only one of its kind, or none (None)."""
        others = self.without(*(e.name for e in self.present() if isinstance(e, kind)))
        return others if effect is None else others.adding(effect)

    def replace(self, **changed: Effect | None) -> Effects:
        """Return the effects with some changed, added, or (None) removed."""
        return _made(type(self), {**dict(self), **changed})

    def adding(self, *effects: Effect) -> Effects:
        """Return the effects with some added; those of the same names are replaced."""
        return self.replace(**{effect.name: effect for effect in effects})

    def of_a_further_image(self) -> Effects:
        """Return the effects without those that belong to one image alone."""
        return self.without(*(e.name for e in self.present() if e.of_one_image))

    def without(self, *names: str) -> Effects:
        """Return the effects without some."""
        return self.replace(**dict.fromkeys(names))

    def fitted(self) -> tuple[Effect, ...]:
        """Return the effects with numbers that are fitted."""
        return tuple(e for e in self.present() if e.fit and e.bounds)

    def to_text(self) -> str:
        """Return the text of ``--effects``: ``halo:fraction=0.05:width=2,bleaching``."""
        words = []
        for effect in self.present():
            fields = effect.model_dump(mode="json", exclude_defaults=True)
            parts = [f"{k}={json.dumps(v, separators=(',', ':'))}" for k, v in fields.items()]
            words.append(":".join([effect.name, *parts]))
        return ",".join(words) or "none"

    @classmethod
    def from_text(cls, text: str) -> Effects:
        """Read :meth:`to_text`'s text; ``attenuation=0.01`` sets the first number of an effect."""
        found: dict[str, dict[str, Any]] = {}
        for word in _split(text, ","):
            head, *parts = _split(word, ":") or [word]
            name, equals, number = head.partition("=")
            name = name.strip().replace("-", "_")
            fields = dict(_field(part) for part in parts)
            if equals and name in KINDS:
                fields = {next(iter(KINDS[name].bounds), "fit"): _value(number), **fields}
            found[name] = fields
        found.pop("none", None)
        return _made(cls, found)

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return plain values of the present effects for JSON and TOML."""
        return {e.name: e.model_dump(mode="json", exclude_none=True) for e in self.present()}


def _split(text: str, mark: str) -> list[str]:
    """Split a text at marks that are not within brackets or quotes."""
    held = r"""\[[^]]*\]|\{[^}]*\}|"[^"]*" """.strip()
    return re.findall(rf"(?:{held}|[^{mark}])+", text)


def _field(part: str) -> tuple[str, Any]:
    name, _, value = part.partition("=")
    return name.strip(), _value(value)


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text.strip()


def as_effects(chosen: Effects | Sequence[str]) -> Effects:
    """Return effects as they are, or make them from names, with their defaults."""
    return chosen if isinstance(chosen, Effects) else Effects.of(*chosen)


def kind_of(role: type[E]) -> type[E]:
    """Return the class of the only effect of a kind."""
    return next(kind for kind in KINDS.values() if issubclass(kind, role))


def check_name(name: str) -> None:
    """Raise a ValueError that says what to do unless it is the name of an effect."""
    if name in REFUSED:
        raise ValueError(f"{name} is no effect: {REFUSED[name]}")
    if name not in KINDS:
        raise ValueError(f"unknown effect '{name}': choose from {', '.join(KINDS)}")


def _made(cls: type[Effects], values: Mapping[str, Any]) -> Effects:
    from pydantic import ValidationError

    try:
        return cls(**values)
    except ValidationError as error:
        raise InputError(first_wrong_value(error)) from None


__all__ = [
    "KINDS",
    "REFUSED",
    "Attenuation",
    "Background",
    "Bleaching",
    "Camera",
    "Cost",
    "DepthEffect",
    "DepthPSF",
    "Detection",
    "DetectorEffect",
    "Effect",
    "Effects",
    "FaceEffect",
    "GainEffect",
    "Halo",
    "Illumination",
    "Missing",
    "OffsetEffect",
    "PixelIntegration",
    "SecondView",
    "TransferEffect",
    "Value",
    "ViewEffect",
    "VoxelEffect",
    "as_effects",
    "kind_of",
]
