"""How the compiled part is built, and what happens where it cannot be."""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(
    not (ROOT / "CMakeLists.txt").exists(), reason="not in a source tree"
)
# Where the sign of a cross product decides.
EXACT = ("bindings.cpp", "remesh.cpp", "proximity.cpp", "remesh_bindings.cpp")


@pytest.fixture(scope="module")
def ninja():
    """What the extension that is tested was built by, if that was here."""
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}-"
    found = [p for p in ROOT.glob("build/*/build.ninja") if p.parent.name.startswith(tag)]
    if not found:
        pytest.skip("the extension was not built here with ninja")
    return max(found, key=lambda path: path.stat().st_mtime).read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="flags of other compilers")
@pytest.mark.parametrize("source", EXACT)
def test_multiplications_are_not_fused_where_signs_must_be_exact(ninja, source):
    rules = re.findall(
        rf"^build \S+: \S+ \S*csrc/{re.escape(source)}(?:\s.*)?\n((?:  .*\n)+)", ninja, re.M
    )
    assert rules
    for rule in rules:
        assert "-ffp-contract=off" in rule


@pytest.mark.parametrize("path", sorted((ROOT / "csrc").glob("*.*")), ids=lambda path: path.name)
def test_headers_are_included_outside_of_namespaces(path):
    """Names of a system's header would be those of the namespace: Windows' did not compile."""
    depth = 0
    for line in path.read_text().splitlines():
        depth += bool(re.match(r"\s*namespace\b.*\{$", line))
        depth -= bool(re.match(r"\}\s*// namespace", line))
        assert not (depth and line.startswith("#include")), line
    assert depth == 0


def built(tmp_path, **variables):
    """Build a wheel with a compiler that fails: how that ended, and the wheels."""
    needs = [name for name in ("pip", "scikit_build_core", "nanobind") if find_spec(name) is None]
    needs += [name for name in ("cmake", "ninja") if shutil.which(name) is None]
    if needs or not os.path.exists("/bin/false"):
        pytest.skip(f"building needs {', '.join(needs) or 'a system like Unix'}")
    kept = {k: v for k, v in os.environ.items() if k not in ("CIBUILDWHEEL", "CONDA_BUILD")}
    done = subprocess.run(
        [
            sys.executable, "-m", "pip", "wheel", "-v", "--no-deps", "--no-build-isolation",
            "-w", str(tmp_path), "--config-settings", f"build-dir={tmp_path / 'build'}", str(ROOT),
        ],
        env={**kept, "CXX": "/bin/false", **variables}, capture_output=True, text=True,
    )  # fmt: skip
    return done, [path.name for path in tmp_path.glob("*.whl")]


@pytest.mark.parametrize("variable", ["CIBUILDWHEEL", "CONDA_BUILD"])
def test_a_failed_compile_makes_no_wheel_for_others(tmp_path, variable):
    done, wheels = built(tmp_path, **{variable: "1"})
    assert done.returncode != 0
    assert wheels == []


def test_a_failed_compile_is_told_loudly(tmp_path):
    done, wheels = built(tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(wheels) == 1
    assert wheels[0].endswith("-py3-none-any.whl")
    assert "WITHOUT its compiled part" in done.stdout + done.stderr
