"""The command line that repeats a run."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

from ..common.description import Described, described
from ..errors import PROGRAM, InputError

if TYPE_CHECKING:
    from .settings import RunSettings


def command(settings: RunSettings, output: str, *, missing: bool = False) -> str:
    """The command line that runs ``fit`` with these settings, quoted for a shell.

    missing : whether voxels that are NaN or infinite are to be left out.

    Raises
    ------
    InputError
        If no flags can describe the PSF.
    """
    words = [PROGRAM, "fit", settings.image, "--seeds", settings.seeds, *options_of(settings)]
    words += ["--missing-nan"] if missing else []
    return shlex.join([*words, "-o", output])


def options_of(settings: RunSettings) -> list[str]:
    """The options of ``fit`` for these settings, without image, seeds and output.

    Raises
    ------
    InputError
        If no flags can describe the PSF.
    """
    scene, channel = settings.scene, described(type(settings))["channel"]
    words = [] if settings.channel is None else _words(channel, settings.channel)
    words += flags_of(scene)
    words += [] if scene.optics is None else optics_flags(scene.optics)
    words += ["--effects", scene.effects.to_text()] if scene.effects.names else []
    return words + flags_of(settings.fit)


def flags_of(settings: Any) -> list[str]:
    """The flags, with values, of all settings that are required or differ from their default.

    Parts, which have settings of their own, are left out.
    """
    words = []
    for name, found in described(type(settings)).items():
        value = getattr(settings, name)
        if found.flag and found.kind != "part" and (found.required or value != found.default):
            words += _words(found, value)
    return words


def optics_flags(settings: Any) -> list[str]:
    """The flags for the settings of a PSF.

    Raises
    ------
    InputError
        If it has settings without a flag, which only a settings file can hold.
    """
    given = {name for name, found in described(type(settings)).items() if found.flag}
    for name, field in type(settings).model_fields.items():
        other = name != "kind" and name not in given
        if other and getattr(settings, name) != field.default:
            raise InputError(
                "no arguments of the command line give this PSF: save the results, whose run.toml "
                "repeats the run"
            )
    return flags_of(settings)


def _words(found: Described, value: Any) -> list[str]:
    if found.kind == "switch":
        return [found.flag if value else f"--no-{found.flag[2:]}"]
    if found.kind == "triple":
        return [found.flag, *(f"{part:.6g}" for part in value)]
    values = value if found.kind == "numbers" else [value]
    exact = [_exact(part) for part in values]
    if len(exact) == 1 and exact[0].startswith("-"):  # argparse may take -1e-5 for a flag
        return [f"{found.flag}={exact[0]}"]
    return [found.flag, *exact]


def _exact(value: Any) -> str:
    """The shortest text that gives back exactly this value."""
    if not isinstance(value, float):
        return str(value)
    short = f"{value:.6g}"
    return short if float(short) == value else repr(value)
