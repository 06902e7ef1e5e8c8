"""What the package says that it needs and runs on, against what it imports."""

import ast
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import napari_deltamic
from napari_deltamic.errors import InputError

ROOT = Path(__file__).parents[1]
PACKAGE = Path(napari_deltamic.__file__).parent
requirements = pytest.importorskip("packaging.requirements")
markers = pytest.importorskip("packaging.markers")

# Imported where they are there, by extras or by what they come with; all else must be declared.
OPTIONAL = {
    "napari",
    "cholespy",
    "cuda",
    "nvidia",
    "cufinufft",
    "dask",
    "distributed",
    "geff",
    "zarr",
}
# Declared, but not imported outright: a solver of some platforms, what tifffile unpacks with.
BEHIND = {"cholespy", "imagecodecs"}
LINUX = {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": "x86_64"}
PLATFORMS = {
    "linux": LINUX,
    "linux on ARM": {**LINUX, "platform_machine": "aarch64"},
    "windows": {
        "sys_platform": "win32",
        "platform_system": "Windows",
        "platform_machine": "AMD64",
    },
    "mac": {"sys_platform": "darwin", "platform_system": "Darwin", "platform_machine": "arm64"},
}


@pytest.fixture(scope="module")
def project():
    path = ROOT / "pyproject.toml"
    if not path.exists():
        pytest.skip("not in a source tree")
    return tomllib.loads(path.read_text())["project"]


def names(lines, platform="linux"):
    """Names of what these requirements install on a platform."""
    wanted = [requirements.Requirement(line) for line in lines]
    here = markers.default_environment() | PLATFORMS[platform]
    return {w.name.lower() for w in wanted if w.marker is None or w.marker.evaluate(here)}


def imported():
    """Top-level names that the package imports from elsewhere."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(str(node.module).split(".")[0])
    return found - set(sys.stdlib_module_names) - {"napari_deltamic"}


def test_what_is_imported_is_declared_and_what_is_declared_is_imported(project):
    distributions = packages_distributions()
    used = {distributions.get(name, [name])[0].lower() for name in imported() - OPTIONAL}
    assert used == names(project["dependencies"]) - BEHIND


@pytest.mark.parametrize(
    ("platform", "wheels"),
    [("linux", True), ("linux on ARM", False), ("windows", True), ("mac", True)],
)
def test_cholespy_is_asked_for_where_there_are_wheels(project, platform, wheels):
    assert ("cholespy" in names(project["dependencies"], platform)) == wheels


def test_the_script_is_what_python_m_runs(project):
    """One place that Ctrl-C cannot pass by while modules load."""
    assert project["scripts"] == {"napari-deltamic": "napari_deltamic.__main__:main"}


@pytest.mark.parametrize("platform", ["linux", "windows"])
def test_the_extra_for_gpus_has_what_compiles_the_kernels(project, platform):
    found = names(project["optional-dependencies"]["gpu"], platform)
    assert "cuda-bindings" in found
    # On Linux it comes with torch.
    assert ("nvidia-cuda-nvrtc" in found) == (platform == "windows")


def test_extras_ask_for_one_napari(project):
    extras = project["optional-dependencies"]
    asked = {name: requirements.Requirement(extras[name][0]) for name in ("qt", "pyside6", "all")}
    assert {str(one.specifier) for one in asked.values()} == {">=0.7.1"}
    assert {name: one.extras for name, one in asked.items()} == {
        "qt": {"pyqt6"}, "pyside6": {"pyside6"}, "all": {"all"},
    }  # fmt: skip


def test_no_platform_is_named_that_nobody_has_run_it_on(project):
    systems = [c for c in project["classifiers"] if c.startswith("Operating System")]
    assert systems == ["Operating System :: POSIX :: Linux"]


@pytest.mark.parametrize("version", ["0.6.6", "0.5.0a1", "0.7.0"])
def test_a_napari_that_is_too_old_is_told(version):
    from napari_deltamic.gui import check_napari

    with pytest.raises(InputError, match=rf"needs napari 0.7.1 or newer, and this is {version}"):
        check_napari(version)


@pytest.mark.parametrize("version", ["0.7.1", "0.7.2rc1", "0.8", "0.10.0rc1", "1.0", "0+unknown"])
def test_other_naparis_are_not(version):
    from napari_deltamic.gui import check_napari

    check_napari(version)


@pytest.mark.slow
def test_types_reach_who_uses_the_package(tmp_path):
    """py.typed is there, and the names that are loaded late have their types."""
    pytest.importorskip("mypy")
    assert (PACKAGE / "py.typed").exists()
    script = tmp_path / "script.py"
    script.write_text(
        "import napari_deltamic as nd\n"
        "grid = nd.Grid((4, 4, 4), (1.0, 1.0, 1.0))\n"
        "reveal_type(grid)\n"
        "reveal_type(nd.load_mesh('a.ply'))\n"
        "nd.nonsense\n"
    )
    settings = tmp_path / "mypy.ini"
    settings.write_text(
        "[mypy]\nfollow_imports = silent\nignore_missing_imports = true\n"
        # Their types take a minute and are of no account here.
        "[mypy-torch.*,numpy.*,scipy.*,skimage.*,pydantic.*]\nfollow_imports = skip\n"
    )
    done = subprocess.run(
        [
            sys.executable, "-m", "mypy", "--config-file", str(settings),
            "--cache-dir", str(tmp_path / "cache"), str(script),
        ],
        capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert '"napari_deltamic.scene.grid.Grid"' in done.stdout
    assert '"napari_deltamic.geometry.mesh.Mesh"' in done.stdout
    assert "has no attribute" in done.stdout
