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
# Divisions to 2 units in the last place: none of them decides about more than rounding.
_OPTIONS = ("--std=c++17", "--prec-div=false")


class CompilerError(RuntimeError):
    """NVRTC is missing or refused the source."""


@dataclass(frozen=True)
class Compiled:
    """A module for the driver, and what the compiler said."""

    code: bytes
    log: str


def source_folder() -> Path:
    """Where the sources lie: in the checkout of an editable installation, or beside this file.

    Raises
    ------
    CompilerError
        If they are nowhere: the package was installed without its compiled part.
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
    """The bindings of NVRTC, its library loaded.

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
    """The version of NVRTC."""
    _, major, minor = nvrtc().nvrtcVersion()
    return int(major), int(minor)


def architecture(capability: tuple[int, int]) -> str:
    """What to compile for: the device itself, or the newest that NVRTC knows as PTX.

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
    """A module for a target such as ``sm_90``, from disk where it was compiled before."""
    path = _kept_file(build, target)
    with suppress(OSError):
        if not anew and _is_ours(path) and (code := path.read_bytes()):
            return code
    code = compile_kernels(build, target).code
    with suppress(OSError, InputError):  # a folder that cannot be written to is no reason to fail
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_atomically(path, code)
    return code


def _is_ours(path: Path) -> bool:
    """Whether nobody else may have put a file there: what it holds is run on the GPU.

    Raises OSError where it is missing.
    """
    if sys.platform == "win32":  # a folder of the user's, by default
        return True
    facts = [path.stat(), path.parent.stat()]
    return all(f.st_uid == os.getuid() and not f.st_mode & stat.S_IWOTH for f in facts)


def kept_folder() -> Path:
    """Where compiled kernels are kept."""
    return cache_folder() / "kernels"


def _kept_file(build: Build, target: str) -> Path:
    """Named after all that the code depends on."""
    parts = [target, str(version()), *build.defines, *_OPTIONS]
    digest = hashlib.sha256(b"\0".join([*map(str.encode, parts), *_sources(build).values()]))
    stem = build.source.removesuffix(".cu")
    return kept_folder() / f"{stem}-{target}-{build.real}-{digest.hexdigest()[:16]}.bin"


def compile_kernels(build: Build, target: str, options: tuple[str, ...] = ()) -> Compiled:
    """Compile the source for a target.

    Raises
    ------
    CompilerError
        If NVRTC is missing or refuses the source; with what it said.
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
