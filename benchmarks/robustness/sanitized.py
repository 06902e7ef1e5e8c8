"""The compiled extensions with AddressSanitizer and UndefinedBehaviorSanitizer.

``python -m pytest -p benchmarks.robustness.sanitized tests/geometry tests/fourier`` runs tests with
them, where the environment is that of :func:`environment`.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "build" / "sanitized"
_FLAGS = (
    "-fsanitize=address,undefined -fno-sanitize-recover=undefined -fno-omit-frame-pointer -g -O1"
)
MODULES = {
    "_mesh_ft": "napari_deltamic.fourier._mesh_ft",
    "_remesh": "napari_deltamic.geometry._remesh",
}


def build() -> Path:
    """Compile; the folder with the extensions."""
    import nanobind

    cmake = ["cmake", "-S", str(ROOT), "-B", str(FOLDER), "-DCMAKE_BUILD_TYPE=None"]
    cmake += [f"-DCMAKE_CXX_FLAGS={_FLAGS}", f"-DPython_EXECUTABLE={sys.executable}"]
    cmake += [f"-Dnanobind_DIR={nanobind.cmake_dir()}"]
    subprocess.run(cmake, check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["cmake", "--build", str(FOLDER), "-j2"], check=True, stdout=subprocess.DEVNULL)
    return FOLDER


def environment() -> dict[str, str]:
    """In which Python can load them."""
    found = subprocess.run(
        ["g++", "-print-file-name=libasan.so"], check=True, capture_output=True, text=True
    )
    cpp = subprocess.run(
        ["g++", "-print-file-name=libstdc++.so.6"], check=True, capture_output=True, text=True
    )
    return {
        **os.environ,
        # The C++ library too: else exceptions thrown before it is loaded cannot be followed.
        "LD_PRELOAD": f"{found.stdout.strip()}:{cpp.stdout.strip()}",
        # Python keeps its memory to the end.
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "PYTHONMALLOC": "malloc",
    }


def load(name: str, folder: Path = FOLDER) -> ModuleType:
    """One of ``MODULES`` from a folder, under the name by which the package imports it."""
    (file,) = folder.glob(f"{name}.*.so")
    spec = importlib.util.spec_from_file_location(MODULES[name], file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[MODULES[name]] = module
    return module


def pytest_configure() -> None:
    """As a plugin of pytest: the package finds these."""
    for name in MODULES:
        load(name)
