"""A fit that was done is not lost to what comes after it."""

import importlib
import io
import json
import logging
import os
import subprocess
import sys

import pytest

from napari_deltamic.cli import main
from napari_deltamic.common.writing import own_folder
from napari_deltamic.errors import InputError
from napari_deltamic.results.report import FILES

SIGMA = ("--sigma", "0.36", "0.24", "0.24")
SHORT = ("--max-iterations", "2")
FIT = "napari_deltamic.fitting.job.fit"


@pytest.fixture
def command(data, tmp_path):
    return ["fit", data / "cell.tif", "--seeds", data / "start.ply", *SIGMA, *SHORT]


def interrupted(monkeypatch, name, times=1):
    """Ctrl-C as soon as this function of the fit's command is called."""
    module = importlib.import_module("napari_deltamic.cli.fit_command")
    original, calls = getattr(module, name), []

    def stopped(*arguments, **options):
        calls.append(1)
        if len(calls) <= times:
            raise KeyboardInterrupt
        return original(*arguments, **options)

    monkeypatch.setattr(module, name, stopped)


@pytest.mark.parametrize("name", ["analyse_residual", "write_results"])
def test_ctrl_c_after_the_last_iteration(command, tmp_path, run, monkeypatch, name):
    interrupted(monkeypatch, name)
    code, _, err = run(*command, "-o", tmp_path / "out")
    assert code == 130
    assert sorted(os.listdir(tmp_path / "out")) == sorted([*FILES, "checkpoint.npz"])
    assert "to go on: napari-deltamic fit" in err


def test_ctrl_c_twice_keeps_the_checkpoint(command, tmp_path, run, monkeypatch):
    interrupted(monkeypatch, "write_results", times=2)
    code, _, err = run(*command, "-o", tmp_path / "out")
    assert code == 130
    assert sorted(os.listdir(tmp_path / "out")) == ["checkpoint.npz", "run.toml"]
    again = err.split("to go on: napari-deltamic ")[1].split()
    assert run(*again)[0] == 0


def test_what_no_settings_hold_is_said_again(command, tmp_path, run, monkeypatch):
    """A residual that is asked for comes with the rest; one of an earlier fit goes."""
    folder = tmp_path / "out"
    interrupted(monkeypatch, "write_results")
    asked = ("--residual", "--effects", "auto")
    monkeypatch.setattr("napari_deltamic.cli.fit_command._Run._with_recommended", lambda run: ())
    _, _, err = run(*command, *asked, "-o", folder)
    ask, go_on = (line.partition(": ")[2] for line in err.splitlines()[-2:])
    assert ask == f"napari-deltamic effects --settings {folder / 'run.toml'}"
    assert run(*go_on.split()[1:])[0] == 0
    assert (folder / "residual.tif").is_file()
    assert run(*command, "--overwrite", "-o", folder)[0] == 0
    assert not (folder / "residual.tif").exists()


def test_bad_input_leaves_nothing_behind(command, tmp_path, run, monkeypatch):
    def refuses(*arguments, **options):
        raise InputError("the image is not to its taste")
        yield

    monkeypatch.setattr(FIT, refuses)
    assert run(*command, "-o", tmp_path / "out")[0] == 2
    assert not (tmp_path / "out").exists()


def test_a_folder_that_another_run_writes_to(command, tmp_path, fails):
    with own_folder(tmp_path / "out"):
        assert "another run" in fails(*command, "-o", tmp_path / "out")


class Full(io.StringIO):
    def write(self, text):
        raise OSError(28, "No space left on device")


def test_a_stdout_that_takes_nothing(command, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdout", Full())
    assert main([str(a) for a in (*command, "-o", tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "report.json").is_file()


def test_a_path_that_stdout_cannot_print(command, tmp_path, monkeypatch):
    taken = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(taken, encoding="ascii"))
    assert main([str(a) for a in (*command, "-o", tmp_path / "zellé")]) == 0
    lines = taken.getvalue().splitlines()
    assert os.fsencode(tmp_path / "zellé" / "report.json") in lines


def test_an_interrupted_overwrite_leaves_the_old_results(command, tmp_path, run, monkeypatch):
    folder = tmp_path / "out"
    assert run(*command, "-o", folder)[0] == 0
    before = {name: (folder / name).read_bytes() for name in FILES}

    def fails(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("napari_deltamic.common.table.Table.to_csv", fails)
    code, _, err = run(*command, "--likelihood", "gaussian", "--overwrite", "-o", folder)
    assert code == 2
    assert "No space left on device" in err
    changed = [name for name in FILES if (folder / name).read_bytes() != before[name]]
    assert changed in ([], ["run.toml"])  # the settings of the checkpoint


def test_control_characters_do_not_reach_the_terminal(data, tmp_path, fails):
    bad = tmp_path / "bad\x1b[2J.ply"
    bad.write_bytes(b"ply\x1b]0;title\x07\n")
    line = fails("fit", data / "cell.tif", "--seeds", bad, *SIGMA, "-o", tmp_path / "out")
    assert line.strip().isprintable()
    assert "\\x1b[2J" in line


def test_unexpected_errors_are_logged(command, tmp_path, run, monkeypatch, caplog):
    def breaks(*arguments, **options):
        raise ZeroDivisionError("oh no")

    monkeypatch.setattr(FIT, breaks)
    with caplog.at_level(logging.ERROR):
        code, _, err = run(*command, "-o", tmp_path / "out")
    assert (code, "-v shows where" in err, "Traceback" in err) == (1, True, False)
    assert caplog.records[-1].exc_info[0] is ZeroDivisionError
    for arguments in (["-v", *command], [*command, "-v"]):
        assert "Traceback" in run(*arguments, "-o", tmp_path / "out")[2]


def test_a_run_that_is_killed_while_it_writes(command, tmp_path):
    """The report tells of what lies beside it, or is not there."""
    code = (
        "import os, pathlib, sys\n"
        "from napari_deltamic.cli import main\n"
        "replace, calls = pathlib.Path.replace, []\n"
        "def watched(path, target):\n"
        "    calls.append(1)\n"
        "    if len(calls) == 4: os._exit(9)\n"
        "    return replace(path, target)\n"
        "pathlib.Path.replace = watched\n"
        "raise SystemExit(main(sys.argv[1:]))\n"
    )
    folder = tmp_path / "out"
    words = [str(a) for a in (*command, "-o", folder)]
    assert main(words) == 0
    done = subprocess.run(
        [sys.executable, "-c", code, *words, "--overwrite"], capture_output=True, timeout=300
    )
    assert done.returncode == 9, done.stderr.decode()
    assert not (folder / "report.json").exists()
    assert main([*words, "--overwrite"]) == 0
    assert json.loads((folder / "report.json").read_text())["iterations"] == 2
    assert sorted(os.listdir(folder)) == sorted([*FILES, "checkpoint.npz"])
