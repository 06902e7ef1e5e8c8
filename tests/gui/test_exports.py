"""Exports of one fit agree, and replace no other result unasked."""

import csv
from dataclasses import replace

import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.gui.results import results_panel
from napari_deltamic.gui.results.results_panel import QFileDialog

from .sessions import done


@pytest.fixture
def results(seeded, spin):
    """The panel, with a result of which something is known."""
    seeded.settings.max_iterations.setValue(2)
    seeded.start()
    spin(done(seeded))
    record = seeded.doc.result
    record.rows = [{**row, "explained": 0.997, "residual_z": 1.5} for row in record.rows]
    record.reached = replace(record.reached, state=replace(record.reached.state))
    seeded.doc.result_changed.emit()
    return seeded.results


def test_all_and_table_hold_the_same_columns_and_values(results, tmp_path):
    results.save_table(str(tmp_path / "t.csv"))
    results.save_all(str(tmp_path / "all"))
    text = (tmp_path / "t.csv").read_text()
    assert (tmp_path / "all" / "measurements.csv").read_text() == text
    (row,) = csv.DictReader(text.splitlines())
    assert (row["explained"], row["residual_z"]) == ("0.997", "1.5")
    assert all(row.values()), "no column is empty everywhere"


def test_a_table_is_named_as_what_it_is(results, tmp_path):
    results.save_table(str(tmp_path / "t.xlsx"))
    assert [path.name for path in tmp_path.iterdir()] == ["t.xlsx.csv"]
    with pytest.raises(InputError, match="is there already"):
        results.save_table(str(tmp_path / "t.xlsx"))
    results.save_table(str(tmp_path / "t.CSV"))
    assert (tmp_path / "t.CSV").exists()


def test_another_result_in_a_folder_is_replaced_only_when_that_is_wanted(
    results, tmp_path, monkeypatch
):
    questions, answers = [], [False, True]

    def confirmed(parent, title, text, yes, no):
        questions.append(text)
        return answers.pop(0)

    monkeypatch.setattr(results_panel, "confirmed", confirmed)
    folder = staticmethod(lambda *given: str(tmp_path))
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", folder)
    (every,) = (one for one in results.export.menu().actions() if one.text() == "All...")
    (tmp_path / "measurements.csv").write_text("of another fit")
    every.trigger()
    assert "holds another result: measurements.csv" in questions[0]
    assert (tmp_path / "measurements.csv").read_text() == "of another fit"
    every.trigger()
    assert (tmp_path / "measurements.csv").read_text().startswith("region,")


def test_the_run_of_an_image_in_no_file_says_so(results, tmp_path, told):
    results.save_all(str(tmp_path))
    assert "image and seeds" in (tmp_path / "run.toml").read_text().splitlines()[0]
    assert "does not repeat this run" in told[-2]
