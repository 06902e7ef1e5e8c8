"""What starts at once: the version, mistakes on the command line, the import of the package."""

import functools
import os
import subprocess
import sys

import pytest

import napari_deltamic as nd
from napari_deltamic.common.choices import EFFECTS
from napari_deltamic.scene.effects import KINDS

# CPU time over that of ``import numpy`` in the same run, as machines differ. Measured is 2.3, which
# is 0.15 to 0.2 s on two cores of 2.1 GHz; where torch is loaded it is 2 to 4 s.
COMMAND, IMPORT = 5, 15


@functools.cache
def numpy_seconds():
    return ran("-c", "import numpy", enough=0.0)[0]


def ran(*command, folder=None, enough=None):
    """A child: its CPU time (the least of three, as others compute here too), how it ended."""
    enough = COMMAND * numpy_seconds() if enough is None else enough
    spent = []
    for _ in range(3):
        with subprocess.Popen(
            [sys.executable, *map(str, command)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder,
        ) as child:  # fmt: skip
            out, err = child.stdout.read(), child.stderr.read()
            _, status, usage = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
        spent.append(usage.ru_utime + usage.ru_stime)
        if spent[-1] < enough:
            break
    return min(spent), child.returncode, out, err


needs_rusage = pytest.mark.skipif(not hasattr(os, "wait4"), reason="the system tells no CPU time")
MISTAKES = {
    "nothing": ((), "COMMAND"),
    "command": (("paint",), "invalid choice: 'paint'"),
    "option": (("fit", "a.tif", "--fast", "-o", "out"), "unrecognized arguments: --fast"),
    "no output": (("fit", "a.tif"), "--output"),
    "choice": (("fit", "a.tif", "--density", "thick", "-o", "out"), "invalid choice: 'thick'"),
    "no image": (("fit", "a.tif", "--seeds", "s.csv", "-o", "out"), "there is no such file"),
    "no seeds": (("fit", "held.tif", "-o", "out"), "fit needs --seeds"),
    "results": (("fit", "held.tif", "--seeds", "held.tif", "-o", "."), "--overwrite"),
    "accuracy": (
        ("fit", "held.tif", "--seeds", "held.tif", "--accuracy", "-1", "-o", "out"),
        "accuracy",
    ),
    "optics": (
        ("fit", "held.tif", "--seeds", "held.tif", "--na", "1.2", "-o", "out"),
        "needs --wavelength",
    ),
    "effects": (("effects", "held.tif"), "effects needs --seeds"),
    "track": (("track", "--frames", "5", "held.tif", "--seeds", "held.tif", "-o", "o"), "A:B"),
    "render": (
        ("render", "a.ply", "--shape", "9", "9", "9", "--voxel-size", "1", "1", "1", "-o", "a.jpg"),
        "unknown image extension",
    ),
    "simulate": (
        ("simulate", "--shape", "9", "9", "9", "--voxel-size", "1", "1", "1", "-o", "out"),
        "simulate needs MESH",
    ),
    "accuracy of what": (("accuracy", "a.txt"), "unknown extension '.txt'"),
}


@needs_rusage
@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_told_at_once(tmp_path, name):
    for held in ("held.tif", "report.json"):
        (tmp_path / held).write_text("")
    arguments, says = MISTAKES[name]
    seconds, code, out, err = ran("-m", "napari_deltamic", *arguments, folder=tmp_path)
    assert (code, out) == (2, "")
    assert says in err
    assert err.count("\n") == 1
    assert seconds <= COMMAND * numpy_seconds()


@needs_rusage
@pytest.mark.parametrize("arguments", [("--version",), ("--help",), ("fit", "--help")])
def test_version_and_help_come_at_once(arguments):
    seconds, code, out, _ = ran("-m", "napari_deltamic", *arguments)
    assert code == 0
    assert out
    assert seconds <= COMMAND * numpy_seconds()


@needs_rusage
def test_the_package_is_imported_at_once():
    seconds, code, _, err = ran("-c", "import napari_deltamic")
    assert code == 0, err
    assert seconds <= IMPORT * numpy_seconds()


def test_mistakes_load_no_engine():
    """The reason for the times above, which a slow machine cannot blur."""
    code = (
        "import sys\n"
        "from napari_deltamic.cli import main\n"
        "main(['fit', 'none.tif', '--seeds', 'none.ply', '-o', 'out'])\n"
        "print(sorted({'torch', 'scipy', 'skimage', 'trimesh', 'tifffile'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_a_batch_whose_workers_fit_does_not_load_the_engine_itself():
    code = (
        "import sys, napari_deltamic.cli.batch_command\n"
        "print(sorted({'torch', 'scipy', 'skimage', 'trimesh'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


@pytest.mark.slow
def test_a_fit_does_not_load_what_torch_traces_with(tmp_path):
    """SymPy takes half a second to load, a tenth of a small fit."""
    code = (
        "import sys\n"
        "from napari_deltamic.cli import main\n"
        "given = ['--shape', '24', '24', '24', '--voxel-size', '0.2', '0.2', '0.2', '-o', 's']\n"
        "assert main(['simulate', '--cells', '2', '--sigma', '0.2', '0.2', '0.2', *given]) == 0\n"
        "assert main(['fit', 's/image.tif', '--seeds', 's/labels.tif', '-o', 'f']) == 0\n"
        "print('sympy' in sys.modules)\n"
    )
    run = {"cwd": tmp_path, "capture_output": True, "text": True}
    done = subprocess.run([sys.executable, "-c", code], **run)
    assert done.stdout.splitlines()[-1:] == ["False"], done.stderr


def test_commands_look_for_cycles_seldom():
    code = (
        "import gc, runpy, sys\n"
        "sys.argv = ['napari-deltamic', '--version']\n"
        "try:\n"
        "    runpy.run_module('napari_deltamic', run_name='__main__')\n"
        "finally:\n"
        "    print(gc.get_threshold()[0])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "50000", done.stderr


@pytest.mark.parametrize("module", ["cli", "cli.arguments", "cli.fit_command"])
def test_ctrl_c_while_modules_load_is_one_line(tmp_path, module):
    """Those of the command line, of its parser, and of the engine; also in what is executed."""
    (tmp_path / "sitecustomize.py").write_text(
        "import signal, sys\n"
        "class Pressed:\n"
        "    def find_spec(self, name, *told):\n"
        f"        if name == 'napari_deltamic.{module}':\n"
        "            exec('signal.raise_signal(signal.SIGINT)')\n"
        "sys.meta_path.insert(0, Pressed())\n"
    )
    words = ["fit", __file__, "--seeds", "auto", "-o", str(tmp_path / "out")]
    done = subprocess.run(
        [sys.executable, "-m", "napari_deltamic", *words],
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (130, "napari-deltamic: error: interrupted\n")


def test_every_public_name_is_there():
    assert set(nd.__all__) <= set(dir(nd))
    for name in nd.__all__:
        assert getattr(nd, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        _ = nd.nonsense


def test_effects_are_listed_as_they_are():
    assert tuple(KINDS) == EFFECTS
