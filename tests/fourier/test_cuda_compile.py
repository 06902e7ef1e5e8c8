"""The GPU kernels compile for every architecture: no warning, no spill, no local memory, no GPU."""

import os
import re
from dataclasses import replace
from functools import cache

import pytest

from napari_deltamic.fourier.cuda import compiler
from napari_deltamic.fourier.cuda.build import CLOSED_FORM, POINTS
from napari_deltamic.fourier.cuda.compiler import CompilerError

ARCHITECTURES = ("sm_75", "sm_80", "sm_86", "sm_89", "sm_90", "sm_100")
KERNELS = {
    "prepare_band",
    "prepare_list",
    "add_parts",
    "face_gradient",
    "list_face_gradient",
    "vertex_gradient",
    "band_forward",
    "band_backward",
    "list_forward",
    "list_backward",
}
POINT_KERNELS = {
    "locate",
    "spread",
    "spread_dipoles",
    "gather",
    "gather_slopes",
    "sum_values",
    "sum_slopes",
    "pull",
}
SINGLE = CLOSED_FORM[True]
BUILDS = pytest.mark.parametrize(
    ("build", "kernels"),
    [(b, KERNELS) for b in CLOSED_FORM.values()] + [(b, POINT_KERNELS) for b in POINTS.values()],
    ids=["closed form, float", "closed form, double", "points, float", "points, double"],
)
# What the assembler says of its own when it is asked to be verbose.
REPORT = re.compile(r"ptxas info +:|ptxas +\. |^ *Function properties|^$")


@pytest.fixture(autouse=True)
def _nvrtc():
    try:
        compiler.nvrtc()
    except CompilerError as error:
        if os.environ.get("CI"):
            raise
        pytest.skip(str(error))


@pytest.fixture
def compiled_once(monkeypatch):
    """The compiler answers as before where it is asked the same again."""
    monkeypatch.setattr(compiler, "compile_kernels", cache_of_compiler)


cache_of_compiler = cache(compiler.compile_kernels)


@cache
def report(build, architecture):
    """The log of the compiler, and for each kernel (registers, bytes on the stack or spilled)."""
    log = compiler.compile_kernels(build, architecture, ("--ptxas-options=-v",)).log
    found, name = {}, ""
    for line in log.splitlines():
        if entry := re.search(r"Compiling entry function '(\w+)'", line):
            name = entry[1]
        elif "stack frame" in line:
            found[name] = sum(int(n) for n in re.findall(r"(\d+) bytes", line))
    return log, found


@BUILDS
@pytest.mark.parametrize(
    "architecture",
    [
        # The oldest, and that of the GPU on which the kernels have run.
        a if a in ("sm_75", "sm_90") else pytest.param(a, marks=pytest.mark.slow)
        for a in ARCHITECTURES
    ],
)
def test_compiles_without_warnings_spills_and_local_memory(build, kernels, architecture):
    log, local = report(build, architecture)
    said = [line for line in log.splitlines() if not REPORT.search(line)]
    assert not said
    assert local == dict.fromkeys(kernels, 0)


@pytest.mark.slow
def test_a_spill_would_be_seen():
    """With sixteen blocks at a time, the registers of the loops do not suffice."""
    _, local = report(replace(SINGLE, resident=16), "sm_90")
    assert local["band_backward"] > 0


def test_source_that_does_not_compile_is_told_with_the_reason():
    with pytest.raises(CompilerError, match=r"refused the kernels for sm_90: .*error"):
        compiler.compile_kernels(SINGLE, "sm_90", ("-DDELTAMIC_TILE=1000",))


@pytest.mark.usefixtures("compiled_once")
def test_second_use_comes_from_disk(tmp_path, monkeypatch):
    monkeypatch.setenv("DELTAMIC_CACHE", str(tmp_path))
    code = compiler.kernels_for(SINGLE, "sm_90")
    (kept,) = (tmp_path / "kernels").iterdir()
    assert kept.read_bytes() == code
    monkeypatch.setattr(compiler, "compile_kernels", None)
    assert compiler.kernels_for(SINGLE, "sm_90") == code


@pytest.mark.usefixtures("compiled_once")
def test_a_damaged_file_is_made_anew(tmp_path, monkeypatch):
    monkeypatch.setenv("DELTAMIC_CACHE", str(tmp_path))
    code = compiler.kernels_for(SINGLE, "sm_90")
    (kept,) = (tmp_path / "kernels").iterdir()
    kept.write_bytes(code[:100])
    assert compiler.kernels_for(SINGLE, "sm_90") == code[:100]  # which the driver refuses
    assert compiler.kernels_for(SINGLE, "sm_90", anew=True) == code
    assert kept.read_bytes() == code


@pytest.mark.usefixtures("compiled_once")
def test_a_folder_that_cannot_be_written_to_is_no_reason_to_fail(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("DELTAMIC_CACHE", str(tmp_path / "file" / "folder"))
    assert compiler.kernels_for(SINGLE, "sm_90")


def test_devices_newer_than_the_compiler_get_ptx():
    assert compiler.architecture((9, 0)) == "sm_90"
    newest = compiler.architecture((99, 0))
    assert newest.startswith("compute_")
    assert b".entry band_forward" in compiler.compile_kernels(SINGLE, newest).code


def test_devices_older_than_the_compiler_are_refused():
    with pytest.raises(CompilerError, match="knows no GPU of sm_35"):
        compiler.architecture((3, 5))
