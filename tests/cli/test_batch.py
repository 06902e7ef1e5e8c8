"""Many fits: what is fitted, what is skipped, what a kill leaves, and the tables."""

import csv
import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from napari_deltamic.cli import build_parser, cluster
from napari_deltamic.cli.arguments.batch_arguments import fit_words
from napari_deltamic.common import writing
from napari_deltamic.errors import InputError
from napari_deltamic.fitting import fit
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.runs.batch import batch_jobs

FAST = ("--max-iterations", "3", "--sigma", "0.36", "0.24", "0.24")
ONE_FAILED = 1  # exit code where an image could not be fitted, whatever became of the others
SEEDS = ("--seeds", "{stem}_seeds.ply")


def rows(path):
    with Path(path).open() as stream:
        return list(csv.DictReader(stream))


@pytest.fixture
def stacks(data, tmp_path):
    """A folder of three images with their seeds; one of other voxels, one that is none."""
    folder = tmp_path / "stacks"
    folder.mkdir()
    pixels, size = read_image(data / "cell.tif")
    for name, sides in (("one", size), ("two", (0.4, 0.2, 0.2))):
        write_image(folder / f"{name}.tif", pixels, sides)
        (folder / f"{name}_seeds.ply").write_bytes((data / "start.ply").read_bytes())
    (folder / "bad.tif").write_text("no image")
    (folder / "bad_seeds.ply").write_bytes((data / "start.ply").read_bytes())
    return folder


def test_a_folder_of_stacks(run, stacks, tmp_path):
    out = tmp_path / "out"
    arguments = ("batch", stacks, *SEEDS, "--workers", 0, "-o", out, *FAST)
    code, lines, err = run(*arguments)
    assert code == ONE_FAILED, err
    assert lines == [str(out / "summary.csv"), str(out / "cells.csv")]
    summary = rows(out / "summary.csv")
    assert [row["name"] for row in summary] == ["bad", "one", "two"]
    assert [row["status"] for row in summary] == ["failed", "ended", "ended"]
    assert "not a readable image" in summary[0]["message"]
    assert "1 of 3 could not be fitted" in err
    cells = rows(out / "cells.csv")
    assert [(row["name"], row["region"]) for row in cells] == [("one", "1"), ("two", "1")]
    own = rows(out / "one" / "measurements.csv")[0]
    assert {k: v for k, v in cells[0].items() if k != "name"} == own
    # Again: nothing is left to do but what failed, and the tables are the same.
    before = [(out / name).read_bytes() for name in ("summary.csv", "cells.csv")]
    stamp = (out / "one" / "report.json").stat().st_mtime_ns
    _, _, err = run(*arguments)
    assert "2 of 3 are done already" in err
    assert (out / "one" / "report.json").stat().st_mtime_ns == stamp
    assert [(out / name).read_bytes() for name in ("summary.csv", "cells.csv")] == before


def test_a_table_of_something_else_is_kept(fails, stacks, tmp_path):
    (tmp_path / "cells.csv").write_text("mine")
    told = fails("batch", stacks, *SEEDS, "--workers", 0, "-o", tmp_path, *FAST)
    assert "holds a cells.csv that no batch wrote: choose another folder" in told
    assert (tmp_path / "cells.csv").read_text() == "mine"


@pytest.mark.usefixtures("judged")
@pytest.mark.slow
def test_other_options_fit_again(run, stacks, tmp_path):
    (stacks / "bad.tif").unlink()
    arguments = ("batch", stacks, *SEEDS, "--workers", 0, "-o", tmp_path / "out")
    assert run(*arguments, *FAST)[0] == 0
    first = rows(tmp_path / "out" / "summary.csv")
    _, _, err = run(*arguments, *FAST[2:], "--max-iterations", "5")
    assert "done already" not in err
    second = rows(tmp_path / "out" / "summary.csv")
    assert [row["iterations"] for row in first] == ["3", "3"]
    assert [row["iterations"] for row in second] == ["5", "5"]


@pytest.mark.usefixtures("judged")
@pytest.mark.slow
def test_other_settings_of_the_same_name_fit_again(run, stacks, data, tmp_path):
    """A file of settings that has changed is another option."""
    (stacks / "bad.tif").unlink()
    (stacks / "two.tif").write_bytes((data / "nan.tif").read_bytes())
    made = tmp_path / "made"
    given = ("fit", data / "cell.tif", "--seeds", data / "start.ply", "-o", made)
    assert run(*given, *FAST)[0] == 0
    toml = made / "run.toml"
    settings = ("--settings", toml)
    arguments = ("batch", stacks, *SEEDS, *settings, "--workers", 0, "-o", tmp_path / "out")
    run(*arguments)
    assert "1 of 2 are done already" in run(*arguments)[2]
    first, second = rows(tmp_path / "out" / "summary.csv")
    assert (first["iterations"], second["status"]) == ("3", "failed")
    assert second["message"].startswith("the image holds 2 NaN voxels")
    toml.write_text(toml.read_text().replace("max_iterations = 3", "max_iterations = 4"))
    assert "done already" not in run(*arguments)[2]
    assert rows(tmp_path / "out" / "summary.csv")[0]["iterations"] == "4"


def test_a_failure_is_told_whole(tmp_path):
    image = tmp_path / "an error: here.tif"
    told = cluster.fit_in_folder(["fit", str(image), "--seeds", "auto", "-o", str(tmp_path / "x")])
    assert told == f"{image}: there is no such file"


def test_a_full_disk_keeps_what_is_finished(run, fails, stacks, tmp_path, monkeypatch):
    """One sentence, the first image is whole, and with room again the rest follows."""
    (stacks / "bad.tif").unlink()
    arguments = ("batch", stacks, *SEEDS, "--workers", 0, "-o", tmp_path / "out", *FAST)
    plain = writing._written

    def no_room(target, data):
        if target.parent.name != "one":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return plain(target, data)

    def fill(*told):
        monkeypatch.setattr(writing, "_written", no_room)
        return fitted(*told)

    fitted = cluster.fit_in_folder
    monkeypatch.setattr(cluster, "fit_in_folder", fill)
    code, lines, err = run(*arguments)
    assert code == 2
    assert lines == []
    assert "Traceback" not in err
    assert err.splitlines()[-1].startswith("napari-deltamic: error: ")
    assert err.endswith("No space left on device\n")
    monkeypatch.undo()
    code, _, err = run(*arguments)
    assert code == 0
    assert "1 of 2 are done already" in err
    assert [row["status"] for row in rows(tmp_path / "out" / "summary.csv")] == ["ended"] * 2


def child(*arguments, **more):
    return subprocess.Popen(
        [sys.executable, "-m", "napari_deltamic", *map(str, arguments)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"}, **more,
    )  # fmt: skip


def test_ctrl_c_ends_the_batch_and_what_it_cut_short_is_fitted_again(
    run, stacks, tmp_path, monkeypatch
):
    (stacks / "bad.tif").unlink()
    out, begun = tmp_path / "out", []

    def interrupted(*given, **options):
        begun.append(given)
        for state in fit(*given, **options):
            yield state
            if len(begun) == 2:
                raise KeyboardInterrupt

    arguments = ("batch", stacks, *SEEDS, "--workers", 0, "-o", out, *FAST)
    with monkeypatch.context() as patched:
        patched.setattr("napari_deltamic.fitting.job.fit", interrupted)
        code, _, err = run(*arguments)
    assert code == 130
    assert "2/2" not in err
    assert [row["status"] for row in rows(out / "summary.csv")] == ["ended", "not done"]
    code, _, err = run(*arguments)
    assert code == 0
    assert "1 of 2 are done already" in err
    assert [row["iterations"] for row in rows(out / "summary.csv")] == ["3", "3"]


@pytest.mark.usefixtures("judged")
@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no groups of processes to interrupt")
def test_ctrl_c_reaches_all_processes_without_tracebacks(stacks, tmp_path):
    pytest.importorskip("distributed")
    for name in ("one", "two"):  # fits that never end: they wait for their seeds
        (stacks / f"{name}_seeds.ply").unlink()
        os.mkfifo(stacks / f"{name}_seeds.ply")
    arguments = ("batch", stacks, *SEEDS, "--workers", 2, "-o", tmp_path / "out", *FAST)
    with child(*arguments, start_new_session=True) as process:
        for line in process.stderr:  # the spoilt one: now all processes are at work
            if line.startswith("1/3"):
                break
        os.killpg(process.pid, signal.SIGINT)
        said = process.stderr.read()
    assert process.wait(60) == 130, said
    assert "interrupted" in said
    assert "Traceback" not in said
    summary = rows(tmp_path / "out" / "summary.csv")
    assert [row["status"] for row in summary] == ["failed", "not done", "not done"]


@pytest.mark.usefixtures("judged")
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="the system has no such kill")
def test_a_kill_loses_nothing_that_is_finished(run, stacks, tmp_path):
    arguments = ("batch", stacks, *SEEDS, "--workers", 0, "-o")
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    with child(*arguments, killed, *FAST) as process:
        for line in process.stderr:
            if line.startswith("2/3"):
                break
        process.kill()
    kept = (killed / "one" / "report.json").stat().st_mtime_ns
    assert run(*arguments, killed, *FAST)[0] == ONE_FAILED
    assert (killed / "one" / "report.json").stat().st_mtime_ns == kept
    assert run(*arguments, whole, *FAST)[0] == ONE_FAILED
    for name in ("summary.csv", "cells.csv"):
        assert (killed / name).read_text() == (whole / name).read_text()


@pytest.mark.usefixtures("judged")
@pytest.mark.slow
def test_processes_of_this_machine(run, stacks, tmp_path):
    pytest.importorskip("distributed")
    out, alone = tmp_path / "out", tmp_path / "alone"
    with child("batch", stacks, *SEEDS, "--workers", 2, "-o", out, *FAST) as process:
        said = process.stderr.read()
    assert process.returncode == ONE_FAILED, said
    assert run("batch", stacks, *SEEDS, "--workers", 0, "-o", alone, *FAST)[0] == ONE_FAILED
    for name in ("summary.csv", "cells.csv"):
        assert (out / name).read_text() == (alone / name).read_text()


def test_a_batch_file(run, stacks, tmp_path):
    (stacks / "batch.toml").write_text(
        'images = ["one*.tif"]\n'
        'seeds = "{stem}_seeds.ply"\n'
        f"options = {list(FAST)}\n"
        '[[runs]]\nimage = "two.tif"\nname = "longer"\noptions = ["--max-iterations", "4"]\n'
        '[[runs]]\nimage = "gone.tif"\nseeds = "one_seeds.ply"\n'
    )
    out = tmp_path / "out"
    code, _, err = run("batch", stacks / "batch.toml", "--workers", 0, "-o", out)
    assert code == ONE_FAILED, err
    summary = {row["name"]: row for row in rows(out / "summary.csv")}
    assert list(summary) == ["one", "longer", "gone"]
    assert summary["one"]["iterations"] == "3"
    assert summary["longer"]["iterations"] == "4"
    assert "there is no such file" in summary["gone"]["message"]


BAD = {
    "missing": (("none",), "there is no such file or folder"),
    "no image": (("empty",), "there is no image"),
    "no match": (("match.toml",), "no file fits 'x/*.tif' in"),
    "no list": (("list.toml",), "images: a list is needed"),
    "an unknown key": (("key.toml",), "runs.0.imag: there is no such setting"),
    "no toml": (("text.toml",), "text.toml"),
    "two of a name": (("twice.toml",), "two images are named a"),
    "an unknown option": (("stacks", "--workers", "0", "--fast"), "--fast"),
    "a wrong value": (("stacks", "--accuracy", "-1"), "accuracy"),
    "a folder": (("output.toml",), "-o is not for a batch"),
    "another option": (("option.toml",), "--fast"),
    "a checkpoint": (("resume.toml",), "--resume is not for a batch"),
    "help": (("help.toml",), "--help is not for a batch"),
    "a name that leads elsewhere": (("name.toml",), "must be the name of one folder, not '../a'"),
    "no seeds": (("stacks", "--workers", "0"), "where does the fit of a start"),
    "workers": (("stacks", "--workers", "-1"), "--workers must be 0 or more"),
    "both": (("stacks", "--workers", "1", "--scheduler", "tcp://x:1"), "leave out --workers"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_no_batch_can_be(fails, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "stacks").mkdir()
    np.save("stacks/a.npy", np.ones((9, 9, 9)))
    Path("key.toml").write_text('[[runs]]\nimag = "a.tif"\n')
    Path("match.toml").write_text('images = ["x/*.tif"]\nseeds = "auto"\n')
    Path("list.toml").write_text("images = 3")
    Path("text.toml").write_text("images = [")
    Path("twice.toml").write_text('images = ["x/a.tif", "y/a.npy"]\n')
    Path("output.toml").write_text('images = ["a.tif"]\nseeds = "auto"\noptions = ["-o", "x"]\n')
    for option in ("resume=x", "help"):
        text = f'images = ["a.tif"]\nseeds = "auto"\noptions = ["--{option}"]\n'
        Path(f"{option.partition('=')[0]}.toml").write_text(text)
    Path("name.toml").write_text('[[runs]]\nimage = "a.tif"\nname = "../a"\n')
    Path("option.toml").write_text('images = ["a.tif"]\nseeds = "auto"\noptions = ["--fast"]\n')
    arguments, says = BAD[name]
    first, rest = arguments[0], arguments[1:]
    assert says in fails("batch", first, "-o", "out", *rest)
    assert not (tmp_path / "out").exists()


def test_a_folder_with_other_files_is_left_alone(fails, stacks, tmp_path):
    (tmp_path / "out" / "one").mkdir(parents=True)
    (tmp_path / "out" / "one" / "thesis.txt").write_text("mine")
    assert "not of a batch" in fails("batch", stacks, *SEEDS, "-o", tmp_path / "out")
    assert (tmp_path / "out" / "one" / "thesis.txt").read_text() == "mine"


def test_a_scheduler_that_does_not_answer(fails, stacks, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("napari_deltamic.cli.cluster._PATIENCE", 0.2)
    said = fails(
        "batch", stacks, *SEEDS, "--scheduler", "tcp://127.0.0.1:9", "-o", tmp_path / "out"
    )
    assert "does not answer" in said


def test_seeds_are_no_images_in_a_folder_named_from_here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("stacks").mkdir()
    for name in ("a.tif", "a_labels.tif"):
        (tmp_path / "stacks" / name).write_text("")
    (job,) = batch_jobs("stacks", "{stem}_labels.tif")
    assert (job.image, job.seeds) == (
        tmp_path / "stacks" / "a.tif",
        str(tmp_path / "stacks" / "a_labels.tif"),
    )


def test_seeds_are_no_images(tmp_path):
    """Nor is what macOS puts beside each file."""
    for name in ("a.tif", "a_labels.tif", "b.ome.tif", "b_labels.tif", "._a.tif"):
        (tmp_path / name).write_text("")
    (tmp_path / "batch.toml").write_text('images = ["*.tif"]\nseeds = "{stem}_labels.tif"\n')
    for jobs in (batch_jobs(tmp_path, "{stem}_labels.tif"), batch_jobs(tmp_path / "batch.toml")):
        assert [(job.name, Path(job.seeds).name) for job in jobs] == [
            ("a", "a_labels.tif"),
            ("b", "b_labels.tif"),
        ]
    for word in ("auto", "auto:12.5"):
        assert {job.seeds for job in batch_jobs(tmp_path, word)} == {word}
    (tmp_path / "a.npy").write_text("")
    with pytest.raises(InputError, match="two images are named"):
        batch_jobs(tmp_path)


def test_options_come_through_as_they_were_typed():
    typed = [
        "--fit-psf", "--no-remesh", "--sigma", "0.3", "0.2", "0.2", "--density", "smooth",
        "--levels", "2.0", "1.0", "--missing-nan",
    ]  # fmt: skip
    parser = build_parser()
    arguments = parser.parse_args(["batch", "x", "-o", "y", "--seeds", "{stem}.csv", *typed])
    again = parser.parse_args(["fit", "x", "-o", "y", *fit_words(arguments)])
    wanted = parser.parse_args(["fit", "x", "-o", "y", *typed])
    assert again == wanted
