"""The one settings object: the command line parses it, the widget shows it, ``run.toml`` holds it.

Lengths are in um, arrays in Z, Y, X. Every field is described once: flags, forms and the reference
page are made from that (see ``description``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self, cast

from pydantic import field_serializer

from ..common.reading import read_text, reading, toml_values
from ..common.toml import toml_document
from ..scene.effects import Effects
from .fit_settings import NEAR_LEVELS as NEAR_LEVELS
from .fit_settings import WIDE_LEVELS as WIDE_LEVELS
from .fit_settings import FitSettings as FitSettings
from .fit_settings import validated as validated
from .scene_settings import RunFields, SceneFields


class SceneSettings(SceneFields):
    """How the image was formed."""

    effects: Effects = Effects()

    @field_serializer("effects")
    def _present(self, effects: Effects) -> dict[str, Any]:
        return effects.to_dict()


class RunSettings(RunFields):
    """A whole run: what is fitted to what, and how. ``run.toml`` holds one."""

    scene: SceneSettings
    fit: FitSettings = FitSettings()

    def to_toml(self) -> str:
        """The settings as a TOML document."""
        return toml_document(self.model_dump())

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a file written by :meth:`to_toml`; InputError names what is wrong."""
        with reading("settings", path):
            return cast(Self, validated(cls, toml_values(read_text(path))))
