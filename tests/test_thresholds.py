"""Every number of the engine that decides something says where it comes from."""

from benchmarks.thresholds import PACKAGE, ROOMS, numbers


def test_no_number_is_without_a_reason():
    files = [file for room in ROOMS for file in (PACKAGE / room).rglob("*.py")]
    found = [n for file in files if file.name != "log_chart.py" for n in numbers(file)]
    assert len(found) > 500
    assert [f"{n.place}: {n.text}" for n in found if not n.explained] == []


def test_a_number_alone_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.thresholds.PACKAGE", tmp_path)
    file = tmp_path / "room.py"
    file.write_text("_A = 7\n_B = 8  # measured\n\ndef f(x):\n    return 0.3 * x\n")
    assert [n.explained for n in numbers(file)] == [False, True, False]
