"""Compiles the kernels with NVRTC at first use and keeps the result on disk."""

from __future__ import annotations

import hashlib
import os
import stat
import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from ...common.cache_folder import cache_folder
from ...common.writing import write_atomically
from ...errors import InputError
from .build import CLOSED_FORM, POINTS, Build

BUILDS = (*CLOSED_FORM.values(), *POINTS.values())
# Divisions may be off by 2 units in the last place, which changes results only by rounding.
_OPTIONS = ("--std=c++17", "--prec-div=false")


class CompilerError(RuntimeError):
    """NVRTC is missing or refused the source."""


@dataclass(frozen=True)
class Compiled:
    """A compiled module for the driver, and the compiler's log."""

    code: bytes
    log: str


def source_folder() -> Path:
    """Return the folder of the sources: the checkout of an editable install, or beside this file.

    Raises
    ------
    CompilerError
        If there are none: the package was installed without its compiled part.
    """
    from . import __path__ as here

    checkout = Path(__file__).resolve().parents[4] / "csrc"
    names = {name for build in BUILDS for name in (build.source, *build.headers)}
    for folder in (checkout, *map(Path, here)):
        if all((folder / name).is_file() for name in names):
            return folder
    raise CompilerError("the sources of the GPU kernels were not installed")


@cache
def _sources(build: Build) -> dict[str, bytes]:
    folder = source_folder()
    return {name: (folder / name).read_bytes() for name in (build.source, *build.headers)}


def nvrtc() -> Any:
    """Return the bindings of NVRTC, with its library loaded.

    Raises
    ------
    CompilerError
        If ``cuda-bindings`` or the library is missing.
    """
    try:
        from cuda.bindings import nvrtc as found
    except ImportError:
        raise CompilerError("the Python package cuda-bindings is missing") from None
    try:
        found.nvrtcVersion()
    except RuntimeError as error:  # the bindings look for the library at the first call
        reason = str(error).strip().split("\n")[0]
        raise CompilerError(f"the library NVRTC is missing ({reason})") from None
    return found


def version() -> tuple[int, int]:
    """Return the version of NVRTC, (major, minor)."""
    _, major, minor = nvrtc().nvrtcVersion()
    return int(major), int(minor)


def architecture(capability: tuple[int, int]) -> str:
    """Return the target: the device itself, or PTX for the newest one that NVRTC knows.

    The driver translates PTX for devices that are newer than the compiler.
    """
    _, known = nvrtc().nvrtcGetSupportedArchs()[:2]
    asked = 10 * capability[0] + capability[1]
    if asked in known:
        return f"sm_{asked}"
    older = [k for k in known if k < asked]
    if not older:
        raise CompilerError(f"NVRTC {'.'.join(map(str, version()))} knows no GPU of sm_{asked}")
    return f"compute_{max(older)}"


def kernels_for(build: Build, target: str, anew: bool = False) -> bytes:
    """Return the module for a target such as ``sm_90``, from disk if it was compiled before."""
    path = _kept_file(build, target)
    with suppress(OSError):
        if not anew and _is_ours(path) and (code := path.read_bytes()):
            return code
    code = compile_kernels(build, target).code
    with suppress(OSError, InputError):  # works without a writable folder, too
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_atomically(path, code)
    return code


def _is_ours(path: Path) -> bool:
    """Whether only this user can have written a file, whose content is run on the GPU.

    Raises OSError if it is missing.
    """
    if sys.platform == "win32":  # a folder of the user's, by default
        return True
    facts = [path.stat(), path.parent.stat()]
    return all(f.st_uid == os.getuid() and not f.st_mode & stat.S_IWOTH for f in facts)


def kept_folder() -> Path:
    """Return the folder in which compiled kernels are kept."""
    return cache_folder() / "kernels"


def _kept_file(build: Build, target: str) -> Path:
    """Return the file of a compiled module, named after everything that its code depends on."""
    parts = [target, str(version()), *build.defines, *_OPTIONS]
    digest = hashlib.sha256(b"\0".join([*map(str.encode, parts), *_sources(build).values()]))
    stem = build.source.removesuffix(".cu")
    return kept_folder() / f"{stem}-{target}-{build.real}-{digest.hexdigest()[:16]}.bin"


def compile_kernels(build: Build, target: str, options: tuple[str, ...] = ()) -> Compiled:
    """Compile the source for a target.

    Raises
    ------
    CompilerError
        If NVRTC is missing or refuses the source, with its log.
    """
    library, sources = nvrtc(), _sources(build)
    headers, names = (
        [sources[name] for name in build.headers],
        [name.encode() for name in build.headers],
    )
    failed, program = library.nvrtcCreateProgram(
        sources[build.source], build.source.encode(), len(headers), headers, names
    )
    if int(failed):
        raise CompilerError(f"NVRTC: {failed}")
    try:
        given = [f"--gpu-architecture={target}", *_OPTIONS, *build.defines, *options]
        (failed,) = library.nvrtcCompileProgram(program, len(given), [o.encode() for o in given])
        log = _text(library.nvrtcGetProgramLogSize, library.nvrtcGetProgramLog, program)
        message = log.rstrip(b"\0").decode(errors="replace").strip()
        if int(failed):
            raise CompilerError(f"NVRTC refused the kernels for {target}: {message or failed}")
        if target.startswith("sm_"):
            code = _text(library.nvrtcGetCUBINSize, library.nvrtcGetCUBIN, program)
        else:
            code = _text(library.nvrtcGetPTXSize, library.nvrtcGetPTX, program)
        return Compiled(code, message)
    finally:
        library.nvrtcDestroyProgram(program)


def _text(size: Any, content: Any, program: Any) -> bytes:
    _, length = size(program)
    out = bytearray(length)
    content(program, out)
    return bytes(out)
