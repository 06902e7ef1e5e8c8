"""The engine stands without Qt and napari, and its parts know only those below them."""

import ast
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

import napari_deltamic

PACKAGE = Path(napari_deltamic.__file__).parent
ORDER = (
    "common",
    "images",
    "geometry",
    "fourier",
    "optics",
    "scene",
    "runs",
    "fitting",
    "evidence",
    "tracking",
    "measure",
    "accuracy",
    "results",
)
GUI = ("gui", "_reader", "_widget", "_writer")


@cache
def modules():
    """Dotted name -> file, of every module of the package."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = ["napari_deltamic", *path.relative_to(PACKAGE).with_suffix("").parts]
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def engine_modules():
    """All but what napari calls; ``__main__`` runs when it is imported."""
    left_out = {*GUI, "__main__"}
    return [name for name in modules() if not left_out & set(name.split("."))]


def part_of(module):
    """Which of the parts in ORDER a module belongs to, or None."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in ORDER else None


@cache
def imported_from(name, path):
    """Absolute names of the modules that a module imports from, and what it takes of each."""
    found = []
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = [*(above if node.level else []), *([node.module] if node.module else [])]
            found.append((".".join(base), [alias.name for alias in node.names]))
        elif isinstance(node, ast.Import):
            found += [(alias.name, []) for alias in node.names]
    return found


def imported(name, path):
    """Absolute names of what a module imports, anywhere in it."""
    for base, taken in imported_from(name, path):
        yield base
        yield from (f"{base}.{one}" for one in taken)


def test_the_engine_loads_neither_qt_nor_napari():
    code = (
        "import importlib, sys\n"
        f"for name in {engine_modules()!r}:\n"
        "    importlib.import_module(name)\n"
        "gui = {'qtpy', 'napari', 'magicgui', 'superqt', 'vispy', 'PyQt5', 'PyQt6', 'PySide6'}\n"
        "print(sorted(gui & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


def test_the_walk_meets_every_part():
    """The tests here would pass on nothing."""
    parts = {part_of(name) for name in engine_modules()}
    assert parts >= set(ORDER)
    assert "napari_deltamic.errors" in engine_modules()


@pytest.mark.parametrize("part", ORDER)
def test_imports_run_one_way(part):
    above = ORDER[ORDER.index(part) + 1 :]
    wrong = [
        f"{name} imports {target}"
        for name, path in modules().items()
        if part_of(name) == part
        for target in imported(name, path)
        if target.startswith("napari_deltamic.")
        and (part_of(target) in above or target.split(".")[1] in (*GUI, "cli"))
    ]
    assert wrong == []


def test_of_the_command_line_only_the_demonstration_opens_the_window():
    found = {
        name
        for name, path in modules().items()
        for target in imported(name, path)
        if name.split(".")[1:2] == ["cli"] and target.split(".")[1:2] in [[one] for one in GUI]
    }
    assert found == {"napari_deltamic.cli.demo_command"}


def test_engine_code_names_no_gui_library():
    wrong = [
        f"{name} imports {target}"
        for name in engine_modules()
        for target in imported(name, modules()[name])
        if target.split(".")[0] in {"qtpy", "napari", "magicgui", "superqt"}
    ]
    assert wrong == []


def test_no_panel_knows_another_and_the_window_knows_no_command():
    gui = {n: p for n, p in modules().items() if n.startswith("napari_deltamic.gui.")}
    panels = {name for name in gui if name.endswith("_panel") and "find_cells" not in name}
    assert len(panels) >= 6
    wrong = [
        f"{name} imports {target}"
        for name, path in gui.items()
        for target, _ in imported_from(name, path)
        if target.startswith("napari_deltamic.cli") or (name in panels and target in panels)
    ]
    assert wrong == []


def test_the_rooms_of_the_window_know_only_those_below_them():
    """Those of the folders; what lies beside them is shared, or is the window itself."""
    rooms = {
        room: {
            target.split(".")[2]
            for name, path in modules().items()
            if name.startswith(f"napari_deltamic.gui.{room}")
            for target, _ in imported_from(name, path)
            if target.startswith("napari_deltamic.gui.")
        }
        - {room}
        for room in sorted(p.name for p in (PACKAGE / "gui").iterdir() if p.is_dir())
        if not room.startswith("_")
    }
    assert rooms["viewing"] == set(), "what shows layers knows nothing of the window"
    while free := [room for room, known in rooms.items() if not known & set(rooms)]:
        for room in free:
            del rooms[room]
    assert rooms == {}, "in a circle"


FITTING = ("solvers", "model", "voxels", "surface", "objective", "rivals", "uncertainty")


def test_the_rooms_of_a_fit_know_only_those_below_them():
    """Those of the folders, in this order; what lies beside them is the fit itself."""
    inside = {
        name: path
        for name, path in modules().items()
        if name.startswith("napari_deltamic.fitting.")
    }

    def room(name):
        last = name.split(".")[2]
        return FITTING.index(last) if last in FITTING else len(FITTING)

    assert {name.split(".")[2] for name, path in inside.items() if name.count(".") > 2} == set(
        FITTING
    )
    wrong = [
        f"{name} imports {target}"
        for name, path in inside.items()
        for target in imported(name, path)
        if target in inside and room(target) > room(name)
    ]
    assert wrong == []


def test_relative_imports_are_understood():
    path = PACKAGE / "fourier" / "plan.py"
    targets = set(imported("napari_deltamic.fourier.plan", path))
    assert {"napari_deltamic.errors", "napari_deltamic.fourier.band"} <= targets


def test_no_two_files_have_the_same_name():
    names = Counter(path.name for path in modules().values() if path.name != "__init__.py")
    assert [name for name, count in names.items() if count > 1] == []


def test_the_top_of_the_package_fits_a_screen():
    entries = {path.name for path in PACKAGE.iterdir()} - {"__pycache__"}
    assert len(entries) <= 24, sorted(entries)


def test_every_module_that_is_imported_exists():
    """mypy does not see one that has moved: it is told to pass over what it cannot find."""
    known = set(modules()) | {"napari_deltamic"}
    wrong = [
        f"{name} imports {base}"
        for name, path in modules().items()
        for base, _ in imported_from(name, path)
        if base.split(".")[0] == "napari_deltamic" and base not in known
    ]
    assert wrong == []


def test_no_circle_of_modules():
    known = modules()
    left = {
        name: {to for to in imported(name, path) if to in known and to != name}
        for name, path in known.items()
        if path.name != "__init__.py"
    }
    # What imports nothing that is left can be taken away; what stays then is in a circle.
    while free := [name for name, to in left.items() if not to & set(left)]:
        for name in free:
            del left[name]
    assert sorted(left) == []
