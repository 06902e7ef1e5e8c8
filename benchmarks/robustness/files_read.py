"""A child of the experiment with files: spoils and reads them, and says what became of them.

A line each: number, ``begun``, ``read``, ``refused`` or ``wrong``, and which file it was.
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import shutil
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

from napari_deltamic import InputError
from napari_deltamic.cli import main as command_line

from .samples import samples
from .spoiling import spoilt

# What of a fit's command is spoilt.
_OPTIONS = {
    "image.tif": "image", "packed.tif": "image", "image.npy": "image", "ply": "seeds",
    "vtk": "seeds", "ascii.vtk": "seeds", "obj": "seeds", "binary.rec": "seeds",
    "points": "seeds", "run": "settings", "checkpoint": "resume", "psf": "psf",
}  # fmt: skip


class Files:
    """Good files in a folder, and a place for spoilt ones."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        good = folder / "good"
        good.mkdir()
        self.found = samples(good)
        self.number = 0

    def spoil(self, name: str, random: np.random.Generator) -> Path:
        """A spoilt copy of a file; beside it lies what lies beside the good one, where it must."""
        source, _ = self.found[name]
        self.number += 1
        place = self.folder / f"{self.number}"
        if name == "tracks":
            shutil.copytree(source.parent, place)
        else:
            place.mkdir()
        (place / source.name).write_bytes(spoilt(source.read_bytes(), random))
        return place / source.name

    def read(self, number: int, random: np.random.Generator) -> tuple[str, str]:
        """What became of a file, and which it was."""
        name = list(self.found)[number % len(self.found)]
        path = self.spoil(name, random)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                self.found[name][1](path)
            return "read", name
        except InputError as error:
            ok = len(str(error).splitlines()) == 1 and len(str(error)) < 2000
            return ("refused" if ok else "wrong"), f"{name}: {error}" if not ok else name
        except Exception as error:
            return "wrong", f"{name}: {type(error).__name__}: {str(error)[:300]}"
        finally:
            shutil.rmtree(path.parent)

    def command(self, number: int, random: np.random.Generator) -> tuple[str, str]:
        """The same through the command line."""
        name = list(_OPTIONS)[number % len(_OPTIONS)]
        path = self.spoil(name, random)
        given = {
            "image": self.found["image.npy"][0], "seeds": self.found["ply"][0],
            "settings": None, "resume": None, "psf": None,
        } | {_OPTIONS[name]: path}  # fmt: skip
        words = ["fit"]
        if given["settings"]:
            words += ["--settings", given["settings"]]
        else:
            words += [
                given["image"],
                "--seeds",
                given["seeds"],
                "--voxel-size",
                "0.3",
                "0.2",
                "0.2",
            ]
            words += ["--levels", "2", "1"]
            sigma = ["--sigma", "0.36", "0.24", "0.24"]
            words += ["--psf", given["psf"]] if given["psf"] else sigma
        words += ["--resume", given["resume"]] if given["resume"] else []
        out = path.parent / "out"
        words += ["--max-iterations", "4" if given["resume"] else "1", "-o", out]
        said, told = io.StringIO(), io.StringIO()
        try:
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
                code = command_line([str(word) for word in words])
        except BaseException as error:
            return "wrong", f"{name}: {type(error).__name__}: {str(error)[:300]}"
        finally:
            left = list(out.iterdir()) if out.exists() else []
            shutil.rmtree(path.parent)
        text = told.getvalue()
        last = (text.strip().splitlines() or [""])[-1]
        if code not in (0, 2) or "Traceback" in text or "Warning" in text:
            return "wrong", f"{name}: exit {code}: {text.strip()[-300:]!r}"
        if code == 2 and left:
            return "wrong", f"{name}: refused, but left {[p.name for p in left]}: {last[:200]!r}"
        if any(not c.isprintable() for c in last):
            return "wrong", f"{name}: unprintable: {last[:200]!r}"
        return ("read" if code == 0 else "refused"), name


def bounded(memory: int) -> None:
    """No more memory than this, where the system can tell."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


def main(what: str, seed: int, first: int, stop: int, seconds: float, memory: int) -> None:
    """Spoil and read the files of these numbers."""
    faulthandler.enable()
    folder = Path(tempfile.mkdtemp(prefix="robustness-"))
    try:
        files = Files(folder)
        bounded(memory)
        for number in range(first, stop):
            random = np.random.default_rng([seed, number])
            print(f"{number}\tbegun\t", flush=True)
            faulthandler.dump_traceback_later(seconds, exit=True)
            word, text = getattr(files, "read" if what == "reader" else "command")(number, random)
            faulthandler.cancel_dump_traceback_later()
            text = " ".join(text.split())
            print(f"{number}\t{word}\t{text}", flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main(sys.argv[1], *(int(a) for a in sys.argv[2:5]), float(sys.argv[5]), int(sys.argv[6]))
