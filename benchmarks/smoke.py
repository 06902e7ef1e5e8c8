"""A wheel in an empty environment without a compiler: demo, fit, and the window.

    python -m benchmarks.smoke --napari 0.7.0 0.9.2 --pins torch==2.13.0

For each Python and each napari an environment is made, the wheel and what it asks for are installed
from wheels alone, and four things must end well: ``doctor`` without a problem, ``demo --headless``,
``fit`` of the demo's image from a table with a point, and a fit in the dock of a real window (under
Xvfb where there is no display). Prints a line for each; exit code 1 if one failed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIMIT = 900.0  # s, of a step
# Opens the dock as a user does, lets the demonstration's fit run to its end, takes a picture.
WINDOW = """
import sys, time, warnings
warnings.simplefilter("ignore")
import napari
from napari_deltamic.cli import demonstration as demo
from napari_deltamic.scene.samples import dividing_cell_sample
from napari_deltamic.gui.live_demo import open_demo
from pathlib import Path
from qtpy.QtWidgets import QApplication

viewer = napari.Viewer()
viewer.window.add_plugin_dock_widget("napari-deltamic", "Fit meshes to membranes")
viewer.open_sample("napari-deltamic", "vesicle")
sample = dividing_cell_sample()
settings = demo.demo_settings(sample, Path("."))
widget = open_demo(viewer, sample, demo.start_mesh(sample), settings)
until = time.monotonic() + 600
while not widget.doc.run.history.loss or widget.doc.run.running:
    QApplication.processEvents()
    time.sleep(0.01)
    assert time.monotonic() < until, "the fit did not end"
viewer.screenshot("window.png", canvas_only=False, flash=False)
message = widget.doc.present().state.message
print(napari.__version__, QApplication.instance().platformName(), message)
viewer.close()
"""


@dataclass
class Place:
    """An environment: its folder, and the variables under which commands run there."""

    folder: Path
    lines: list[str] = field(default_factory=list)

    @property
    def python(self) -> str:
        return str(self.folder / "bin" / "python")

    def variables(self) -> dict[str, str]:
        """Those of this process, with no compiler on the path and none of its Python's."""
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
        kept |= {"CC": "/bin/false", "CXX": "/bin/false"}
        kept |= {"DELTAMIC_CACHE": str(self.folder / "cache")}
        return {**kept, "PATH": str(self.folder / "bin")}

    def run(self, what: str, *words: str) -> str:
        """Run a command; its output, or RuntimeError with its end."""
        began = time.monotonic()
        done = subprocess.run(
            words,
            env=self.variables(),
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=LIMIT,
        )
        if done.returncode:
            raise RuntimeError(f"{what}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
        self.lines.append(f"{what}: {time.monotonic() - began:.0f} s")
        return done.stdout


def built(python: str, folder: Path) -> Path:
    """The wheel for a Python."""
    words = [python, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(folder), str(ROOT)]
    subprocess.run(words, check=True, env={**os.environ, "CIBUILDWHEEL": "1"})
    (wheel,) = folder.glob("*.whl")
    return wheel


def installed(python: str, wheel: Path, folder: Path, pins: list[str], extra: str) -> Place:
    """An environment with the wheel, and no compiler."""
    subprocess.run([python, "-m", "venv", str(folder)], check=True)
    place = Place(folder)
    pip = (place.python, "-m", "pip", "install", "-q", "--only-binary", ":all:")
    place.run("install", *pip, f"{wheel}[{extra}]", *pins)
    return place


def tried(place: Place) -> None:
    """The four things; RuntimeError where one fails."""
    program = str(place.folder / "bin" / "napari-deltamic")
    facts = json.loads(place.run("doctor", program, "doctor", "--json"))
    if not facts["engines"]["closed form"].startswith("compiled"):
        raise RuntimeError(f"doctor: {facts['engines']}")
    place.run("demo", program, "demo", "--headless", "-o", "demo")
    (place.folder / "points.csv").write_text("z,y,x\n6.05,6.32,6.32\n")
    image = str(place.folder / "demo" / "image.tif")
    place.run("fit", program, "fit", image, "--seeds", "points.csv", "-o", "fit")
    display = os.environ.get("DISPLAY")
    server = (
        [] if display else [str(shutil.which("xvfb-run")), "-a", "-s", "-screen 0 1600x1000x24"]
    )
    words = [*server, place.python, "-c", WINDOW]
    if server:  # which needs the path that the rest must not have
        words[0:0] = ["/usr/bin/env", f"PATH={os.defpath}"]
    place.lines.append(place.run("window", *words).strip().splitlines()[-1])


def main() -> int:
    """Try every combination; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--python", nargs="+", default=[sys.executable], metavar="P")
    add("--napari", nargs="+", default=["0.7.0", "0.9.2"], metavar="V")
    add("--extra", nargs="+", default=["qt"], metavar="E", help="qt, pyside6")
    add("--pins", nargs="*", default=[], metavar="R", help="further requirements, of torch say")
    add("--keep", metavar="DIR", help="where the environments stay")
    asked = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as temporary:
        top = Path(asked.keep or temporary).absolute()
        for p, python in enumerate(asked.python):
            wheel = built(python, top / f"wheel{p}")
            for version in asked.napari:
                for extra in asked.extra:
                    pins = [*asked.pins, f"napari=={version}"]
                    print(f"{wheel.name}, napari {version}, {extra}", flush=True)
                    try:
                        folder = top / f"{p}-{version}-{extra}"
                        place = installed(python, wheel, folder, pins, extra)
                        tried(place)
                        print("  " + "; ".join(place.lines), flush=True)
                    except (RuntimeError, subprocess.SubprocessError) as error:
                        failed += 1
                        print(f"  FAILED {error}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
