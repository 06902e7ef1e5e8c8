"""What makes a fit good, fair or poor."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import napari_deltamic as nd
from napari_deltamic.evidence import analyse_residual, fit_facts
from napari_deltamic.evidence.dents import Dent
from napari_deltamic.evidence.estimate import Finding
from napari_deltamic.evidence.facts import CellFacts, Facts
from napari_deltamic.evidence.first_sigma import FirstSigma
from napari_deltamic.evidence.fit_facts import facts_of
from napari_deltamic.evidence.predicted_error import (
    PredictedError,
    ShapeDeviation,
    predicted_error,
)
from napari_deltamic.evidence.reason import Reason, texts
from napari_deltamic.evidence.slices_apart import SlicesApart
from napari_deltamic.evidence.verdict import judged
from napari_deltamic.evidence.verdict_rules import RULES
from napari_deltamic.fitting import fit
from napari_deltamic.fitting.job import FitInput
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.border import cut_cells
from napari_deltamic.geometry.labels.voxels import voxel_labels
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene.effects import Background, Effects
from napari_deltamic.scene.light import Light

FINE = Facts(True, 0.95, {"across": 1.0}, False, (CellFacts(1, 0.95, 0.01, 1.3),))


def test_a_fit_without_fault_is_good():
    found = judged(FINE)
    assert (found.grade, found.reasons) == ("good", ())
    assert found.sentence() == "good"


@pytest.mark.parametrize(
    ("change", "grade", "word"),
    [
        ({"finished": False}, "poor", "has not converged"),
        ({"finished": False, "by_hand": True}, "poor", "changed by hand"),
        ({"explained": 0.6}, "fair", "60% of the signal"),
        ({"explained": 0.2}, "poor", "20% of the signal"),
        ({"explained": -1.7}, "poor", "none of the signal"),
        ({"explained": None}, "poor", "noise"),
        ({"widths": {"across": 2.4}}, "fair", "2.4 times as blurred"),
        ({"widths": {"across": 0.5}}, "fair", "2 times as sharp in XY as the PSF"),
        ({"widths": {"across": 1.0, "along Z": 0.4}}, "poor", "2.5 times as sharp in Z"),
        ({"widths": {"across": 0.6, "along Z": 0.6}}, "fair", "1.7 times as sharp in Z"),
        ({"widths": {"across": 1.0, "along Z": 2.4}}, "good", "good"),
        ({"narrow": True}, "fair", "too narrow for the voxels"),
        ({"missing": (4,)}, "fair", "point 4 has no cell"),
        ({"missing": (2, 4)}, "fair", "points 2 and 4 have no cell"),
        ({"cut": 0.6}, "fair", "60% of the bright voxels are saturated"),
        ({"cut": 0.3}, "good", "good"),
        ({"compressed": True}, "fair", "look log-scaled"),
        ({"followed": 0.3}, "poor", "the seeds did not match the image, and the surfaces hardly"),
        ({"followed": 0.5}, "good", "good"),
        ({"doubts": ("is the step along Z too large?",)}, "fair", "is the step along Z too large?"),
        ({"unsure": True}, "fair", "membranes may be fluorescent, and"),
        ({"alone": True}, "fair", "insides alone may explain as much"),
        ({"nuclei": True}, "fair", "a dim middle was taken for a dark nucleus"),
        ({"lit": True}, "fair", "subtracted as a local background, a rough estimate"),
        ({"leans": True}, "fair", "a tilted PSF's tails"),
        ({"blurred_deep": True}, "fair", "in widefield"),
        (
            {"slices": SlicesApart(shift=0.43)},
            "fair",
            "shifted against each other by about 0.4",
        ),
        ({"slices": SlicesApart(brightness=0.12)}, "fair", "brightness of slices varies by 12%"),
        ({"slices": SlicesApart(0.1, 0.05)}, "good", "good"),
        ({"dome": 0.57}, "fair", "a haze up to 57% as bright as the surfaces"),
        ({"dome": 0.2}, "good", "good"),
        ({"sharpened": True}, "fair", "looks deconvolved"),
        ({"accuracy": 0.1}, "fair", "rendered with an error of 10%"),
        ({"accuracy": 0.02}, "good", "good"),
        ({"single": True}, "poor", "only one slice holds an image, which does not tell how high"),
    ],
)
def test_what_concerns_all(change, grade, word):
    found = judged(replace(FINE, **change))
    assert found.grade == grade
    assert word in found.sentence()


@pytest.mark.parametrize(
    ("change", "grade", "word"),
    [
        ({"explained": 0.3}, "poor", "30%"),
        ({"stray": 0.4}, "fair", "light inside"),
        (
            {"left_out": (0.22, (1, 2.04, 3))},
            "fair",
            "22% of its light, brightest at (1.0, 2.0,",
        ),
        (
            {"left_out": (1.2, (1, 2, 3))},
            "fair",
            "more than its light, brightest at (1.0,",
        ),
        ({"left_out": (0.03, (1, 2, 3))}, "good", "good"),
        (
            {"enclosed": 7.05},
            "fair",
            "a membrane 7 times as bright encloses it: is its label that of the nucleus?",
        ),
        ({"growth": 5.0}, "fair", "swallowed"),
        ({"growth": 0.05}, "poor", "shrunk"),
        ({"point": True}, "poor", "shrunk to a point"),
        ({"slices": 2.4}, "fair", "only 2.4 slices high"),
        ({"slices": 3.1}, "good", "good"),
        ({"crowded": True}, "fair", "several points lie in it"),
        ({"cut": True}, "fair", "border"),
        ({"inside": 0.4}, "fair", "light inside"),
        ({"inside": -0.4}, "fair", "light around it, 40% as bright as its surface, is not in"),
        (
            {"inside": 3e30},
            "fair",
            "light inside it, brighter than its surface, is not in the model",
        ),
        ({"medium": 0.05}, "fair", "its inside is darker than the medium, but it is not"),
        ({"medium": 0.97}, "good", "good"),
        ({"compact": 0.4}, "fair", "crumpled"),
        ({"uneven": 0.2}, "fair", "its interior brightness varies by 20%"),
        ({"uneven": 0.8, "inside_share": 0.08}, "good", "good"),  # its membrane tells the border
        ({"seen": 0.7}, "fair", "the image is missing at 30% of its surface"),
        ({"seen": 0.2}, "poor", "the image is missing at 80% of its surface"),
        ({"seen": 0.92}, "good", "good"),
        ({"counted": 0.7}, "fair", "30% of its surface lies in light assigned to other objects"),
        ({"counted": 0.2}, "poor", "is its seed in the right place"),
        ({"counted": 0.92}, "good", "good"),
        ({"unseen_wall": 4}, "fair", "hardly shows its wall with cell 4: they may be one cell"),
        (
            {"dent": Dent((1, 2.04, 3))},
            "fair",
            "a thin dent reaches to (1.0, 2.0, 3.0) um: is",
        ),
        ({"dent": Dent((1, 2, 3), False)}, "fair", "something bright there, inside the cell?"),
        ({"dent": Dent((1, 2, 3), True)}, "fair", "inside the cell, or two cells under one label?"),
        ({"fold": (1.0, 2.04, 3.0)}, "fair", "folded at (1.0, 2.0, 3.0) um: are these two cells"),
        ({"lit": 0.35}, "fair", "only 35% of its surface is bright"),
        ({"lit": 0.2}, "poor", "only 20% of its surface is bright"),
    ],
)
def test_what_concerns_one_cell(change, grade, word):
    found = judged(replace(FINE, cells=(replace(FINE.cells[0], **change),)))
    assert found.cells[0].grade == found.grade == grade
    assert word in found.sentence()


@pytest.mark.parametrize(
    ("parts", "grade", "word"),
    [
        ((0.02, 0.0, 0.01), "good", "off by about 7 nm"),
        ((0.5, 0.1, 0.1), "fair", "0.78 voxels, mainly due to the noise"),
        ((0.1, 0.6, 0.1), "fair", "too few iterations"),
        ((0.1, 0.1, 0.1, 0.6), "fair", "triangles that are too large"),
        ((0.1, 0.1, 0.1, 0.5, 0.6), "fair", "0.99 voxels, mainly due to triangles"),
        ((0.1, 0.1, 0.1, 0.1, 2.0), "poor", "what the model lacks (light inside)"),
    ],
)
def test_a_predicted_error_decides(parts, grade, word):
    off = ShapeDeviation(*(0.2 * part for part in parts))
    error = PredictedError(off, {1: off}, "light inside")
    found = judged(replace(FINE, error=error, voxel=0.2))
    assert found.grade == found.cells[0].grade == grade
    assert word in found.sentence()
    assert found.by_region()[1].shape_error_um == pytest.approx(off.total)
    assert found.as_plain()["error"]["whole_um"]["total"] == pytest.approx(off.total)


def test_what_a_user_can_say_of_membranes_is_asked():
    off = ShapeDeviation(0.0, 0.0, 0.0, 0.0, 0.1)
    for lacks in ("light of membranes", "light inside"):
        error = PredictedError(off, {1: off}, lacks)
        words = judged(replace(FINE, error=error, voxel=0.2)).sentence()
        assert ("(try --structure interior)" in words) == (lacks == "light of membranes")


@pytest.mark.parametrize(("cut", "grade"), [(0.3, "good"), (0.6, "fair"), (0.8, "poor")])
def test_an_image_that_is_mostly_cut_is_not_trusted(cut, grade):
    found = judged(replace(FINE, cut=cut))
    assert found.grade == grade
    assert ("80% of the bright voxels are saturated" in found.sentence()) == (cut == 0.8)


def test_what_is_not_a_number_is_no_reason():
    names = (
        "explained",
        "stray",
        "growth",
        "inside",
        "compact",
        "uneven",
        "lit",
        "seen",
        "counted",
    )
    cell = replace(FINE.cells[0], **dict.fromkeys([*names, "medium", "slices"], np.nan))
    of_all = dict.fromkeys(["explained", "cut", "dome", "followed", "accuracy"], np.nan)
    assert judged(replace(FINE, cells=(cell,), **of_all)).reasons == ()


def test_a_cell_that_is_not_told_from_noise_is_poor():
    """What it explains cannot be told then, and its predicted error follows noise."""
    cells = (CellFacts(1, 0.95, shown=200.0), CellFacts(2, None, shown=4.0), CellFacts(3, 0.9))
    found = judged(replace(FINE, cells=cells))
    assert [cell.grade for cell in found.cells] == ["good", "poor", "good"]
    assert found.cells[1].reasons[0].text.startswith("the image hardly shows it")
    for faint in (CellFacts(1, None, shown=9.0), CellFacts(1, 0.9, shown=4.0)):
        assert judged(replace(FINE, cells=(faint,))).grade == "good"


def test_a_cell_that_outgrew_all_others_is_poor():
    """Alone, it may have begun as a small ball."""
    cells = tuple(CellFacts(k, 0.9, growth=1.1) for k in range(1, 5))
    astray, larger = CellFacts(5, 0.9, growth=20.0), CellFacts(6, 0.9, growth=5.0)
    found = judged(replace(FINE, cells=(*cells, astray, larger)))
    assert [cell.grade for cell in found.cells] == ["good"] * 4 + ["poor", "fair"]
    assert judged(replace(FINE, cells=(astray,))).grade == "fair"


@pytest.mark.parametrize(("others", "whole"), [(5, "fair"), (8, "fair"), (9, "good")])
def test_one_bad_cell_spoils_no_other_and_is_named(others, whole):
    cells = (*(CellFacts(k, 0.9, 0.0, 1.0) for k in range(2, others + 2)), CellFacts(1, 0.2))
    found = judged(replace(FINE, cells=cells))
    assert found.grade == whole
    assert "cell 1 is poor (20% of the signal around it is explained)" in texts(found.reasons)
    assert [cell.grade for cell in found.cells] == ["good"] * others + ["poor"]


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("unsure", {"unsure": True}),
        ("alone", {"alone": True}),
        ("nuclei", {"nuclei": True}),
        ("lit", {"lit": True}),
        ("leans", {"leans": True}),
        ("blurred_deep", {"blurred_deep": True}),
        ("widths", {"widths": {"across": 0.6}}),
        ("widths", {"widths": {"across": 1.5}}),
        ("narrow", {"narrow": True}),
        ("cone", {"error": PredictedError(cone=True)}),
        ("compressed", {"compressed": True}),
        ("shifted", {"slices": SlicesApart(shift=0.43)}),
        ("flicker", {"slices": SlicesApart(brightness=0.12)}),
        ("dome", {"dome": 0.6}),
        ("sharpened", {"sharpened": True}),
        ("doubted", {"doubts": ("is the step along Z too large?",)}),
        ("coarse", {"accuracy": 0.1}),
    ],
)
def test_a_doubt_about_what_cells_share_is_one_about_each_cell(kind, change):
    """If it is right, each of them ends further in or out; and it is told of all once."""
    cells = (CellFacts(1, 0.95), CellFacts(2, 0.95), CellFacts(3, 0.2))
    found = judged(replace(FINE, cells=cells, **change))
    text, bad = texts(found.reasons)
    assert [cell.grade for cell in found.cells] == ["fair", "fair", "poor"]
    assert [cell.reasons[-1].text for cell in found.cells] == [text] * 3
    assert bad == "cell 3 is poor (20% of the signal around it is explained)"
    (alone,) = judged(replace(FINE, **change)).reasons
    assert (alone.kind, alone.text) == (kind, text)


@pytest.mark.parametrize(
    "change",
    [{"widths": {"across": 0.4}}, {"followed": 0.3}, {"explained": None}, {"single": True}],
)
def test_where_what_they_share_is_poor_each_cell_is_and_that_comes_first(change):
    cells = CellFacts(1, 0.95), CellFacts(2, 0.95, stray=0.4)
    found = judged(replace(FINE, cells=cells, **change))
    assert found.grade == "poor"
    assert [cell.grade for cell in found.cells] == ["poor", "poor"]
    assert [len(cell.reasons) for cell in found.cells] == [1, 2]
    assert found.reasons[0] == found.cells[0].reasons[0] == found.cells[1].reasons[0]
    told = "cell 2 would be fair even without that (unexplained light beside it, 40% of its light:"
    assert texts(found.reasons)[1].startswith(told)


def test_what_each_cell_tells_itself_leaves_the_others_good():
    cells = CellFacts(1, 0.95), CellFacts(2, 0.95), CellFacts(3, 0.2)
    found = judged(replace(FINE, explained=0.6, cut=0.6, finished=False, cells=cells))
    assert found.grade == "poor"
    assert [cell.grade for cell in found.cells] == ["good", "good", "poor"]


def test_many_doubts_at_once_are_poor():
    doubted = replace(FINE, narrow=True, cut=0.6, compressed=True, explained=0.6)
    assert len(judged(doubted).reasons) == RULES.doubts - 1
    assert judged(doubted).grade == "fair"
    two = (replace(FINE.cells[0], slices=2.0), replace(FINE.cells[0], region=2))
    one_more = judged(replace(doubted, cells=two))
    assert [cell.grade for cell in one_more.cells] == ["poor", "fair"]
    assert "too many doubts" in one_more.cells[0].reasons[0].text
    alone = judged(replace(doubted, cells=two[:1]))
    assert alone.grade == "poor"


def test_the_error_told_is_that_of_the_cell_in_the_middle_as_the_grade_is():
    small, large = ShapeDeviation(0.01, 0, 0), ShapeDeviation(5.0, 0, 0)
    error = PredictedError(large, {1: small, 2: small, 3: large})
    cells = tuple(CellFacts(k, 0.9) for k in (1, 2, 3))
    found = judged(replace(FINE, cells=cells, error=error))
    assert found.sentence().startswith("fair, off by about 15 nm: cell 3 is poor (")
    both = judged(replace(FINE, cells=cells[1:], error=error))
    assert both.sentence().startswith("poor, off by about 7500 nm")


def test_cells_that_are_no_better_have_the_usual_reason_with_them():
    cut = CellFacts(1, 0.9, cut=True)
    cells = (cut, *(CellFacts(k, 0.9, cut=True, lit=0.1 + 0.05 * k) for k in (2, 3)))
    (reason,) = judged(replace(FINE, cells=cells)).reasons[1:]
    told = "as with cell 2: only 20% of its surface is bright: the rest is a guess"
    assert reason == Reason("cells", "poor", f"cells 2 and 3 are poor ({told})")
    some = judged(replace(FINE, cells=(cut, CellFacts(2, 0.6), CellFacts(3, 0.7)))).reasons
    told = "mostly as with cell 2: 60% of the signal around it is explained"
    assert texts(some) == (f"cells 1, 2 and 3 are fair ({told})",)


def test_growth_is_compared_with_the_other_cells():
    alike = tuple(CellFacts(k, 0.9, 0.0, 4.0) for k in range(1, 7))
    assert judged(replace(FINE, cells=alike)).grade == "good"
    one = (*alike, CellFacts(7, 0.9, 0.0, 20.0))
    assert [c.grade for c in judged(replace(FINE, cells=one)).cells] == ["good"] * 6 + ["fair"]


def test_facts_of_a_fit(monkeypatch):
    size, shape = (0.2, 0.2, 0.2), (24, 24, 24)
    grid, optics = nd.Grid(shape, size), nd.GaussianPSF((0.24, 0.24, 0.24))
    truth = sphere((2.3, 2.3, 2.3), 1.5, edge_length=0.3)
    image = nd.render(truth, grid, optics).numpy()
    image = np.random.default_rng(0).poisson(20 + 200 * image / image.max()).astype(np.float32)
    start = sphere((2.3, 2.3, 2.3), 1.2, edge_length=0.4)
    scene = SceneSettings(voxel_size=size, sigma=optics.sigma_um)
    run = RunSettings(image="", seeds="", scene=scene, fit=FitSettings())
    *_, state = fit(image, grid, start, optics, settings=run.fit)
    job = FitInput(run, image, grid, start, optics, None)
    facts = facts_of(job, state, analyse_residual(image, grid, state))
    assert facts.finished
    assert facts.slices.shift < 0.03
    assert facts.slices.brightness < 0.02
    assert not facts.sharpened
    assert facts.dome == 0
    assert (facts.doubts, facts.followed, facts.single) == ((), None, False)
    # The errors of other states, which take longest, are looked at further below.
    monkeypatch.setattr(fit_facts, "predicted_error", lambda *given: facts.error)
    wide = replace(job, grid=nd.Grid(shape, (0.2, 0.2, 0.4)))
    (doubt,) = facts_of(wide, state, analyse_residual(image, grid, state)).doubts
    assert "0.2 um along Y but 0.4 um along X" in doubt
    with monkeypatch.context() as as_if:  # no start followed it
        as_if.setattr(fit_facts, "SANITY", replace(fit_facts.SANITY, followed=1.0))
        followed = facts_of(job, state, analyse_residual(image, grid, state)).followed
    assert RULES.followed < followed < 1
    high = float(np.ptp(state.rendered()))
    for place, number, dome in ((0, high, 0.0), (3, -high / 3, 0.5)):  # Legendre's in z
        ground = Background(order=2, coefficients=tuple(number * (k == place) for k in range(9)))
        hazy = replace(state, effects=Effects.of(ground))
        z = np.linspace(-1, 1, shape[0])[:, None, None]
        along = z if place == 0 else (3 * z**2 - 1) / 2
        left = analyse_residual(image, grid, hazy)
        found = facts_of(job, hazy, left, state.rendered() + number * along).dome
        assert found == pytest.approx(dome, abs=0.02)
    assert facts.explained > 0.95
    assert set(facts.widths) == {"across", "along Z"}
    assert list(facts.widths.values()) == pytest.approx([1, 1], abs=0.2)
    for told, axes in ((0.13, {"across", "along Z"}), (0.11, {"across"})):  # um; 0.6 voxel: 0.12
        sharp = FirstSigma(Finding(told), Finding(0.24))
        with monkeypatch.context() as patch:
            patch.setattr(fit_facts, "first_sigma", lambda *given, sharp=sharp, **_: sharp)
            assert set(facts_of(job, state, analyse_residual(image, grid, state)).widths) == axes
    (cell,) = facts.cells
    assert cell.growth == pytest.approx((1.5 / 1.2) ** 3, rel=0.1)
    assert not cell.cut
    assert cell.inside == pytest.approx(0, abs=0.05)
    assert cell.compact == pytest.approx(1, abs=0.05)
    assert cell.lit > 0.95
    high = state.mesh.vertices_numpy()[state.mesh.faces].mean(1)[:, 0] > 3.2  # a fifth of it
    capped = facts_of(job, replace(state, density=5.0 * high), analyse_residual(image, grid, state))
    assert capped.cells[0].lit == pytest.approx(high.mean(), abs=0.05)
    assert judged(capped).grade == "poor"
    assert judged(facts).grade == "good"
    assert not cell.point
    assert not cell.crowded
    crowded = facts_of(
        replace(job, crowded=frozenset({cell.region})), state, analyse_residual(image, grid, state)
    )
    assert crowded.cells[0].crowded
    beside = 0.3, (1.0, 2.0, 3.0)
    monkeypatch.setattr(fit_facts, "left_out", lambda *given: {cell.region: beside})
    inside = replace(state, light=Light(membrane=0.0, interior=1.0))
    both = replace(state, light=Light(membrane=1.0, interior=1.0))
    monkeypatch.setattr(fit_facts, "enclosing_membranes", lambda *given: {cell.region: 4.0})
    for lit, told, around in ((state, None, 4.0), (inside, beside, None), (both, None, 4.0)):
        found = facts_of(job, lit, analyse_residual(image, grid, state))
        assert (found.cells[0].left_out, found.cells[0].enclosed) == (told, around)
    assert cell.slices == pytest.approx(3.0 / size[0], rel=0.02)
    middle, places = np.full(3, 2.3), state.mesh.vertices_numpy()
    small = replace(state, mesh=state.mesh.with_vertices(middle + 0.1 * (places - middle)))
    assert facts_of(job, small, analyse_residual(image, grid, state)).cells[0].point
    hidden = image.copy()
    hidden[:, :, 12:] = np.nan
    half = facts_of(replace(job, image=hidden), state, analyse_residual(hidden, grid, state))
    one = np.where(np.arange(shape[0])[:, None, None] == 11, image, np.nan)
    one_job = replace(job, image=one)
    single = facts_of(one_job, state, analyse_residual(one, grid, state))
    assert (single.single, single.error.whole) == (True, None)
    assert judged(single).sentence().startswith("poor: ")
    assert half.cells[0].seen == pytest.approx(0.5, abs=0.05)
    assert facts.error.unknown == ""
    # Of 200 photons and a surface of 0.2 um voxels: a few nm, and nothing that it lacks.
    assert 0.0005 < facts.error.whole.total < 0.02
    smoothed = replace(job, image=gaussian_filter(image, 1.0))
    assert facts_of(smoothed, state, analyse_residual(image, grid, state)).widths == {}
    wide = replace(state, optics=nd.GaussianPSF(0.7))  # much too wide, even so
    found = facts_of(smoothed, wide, analyse_residual(image, grid, wide)).widths
    assert set(found) == {"across"}
    assert found["across"] < 0.5
    hazy = image + 80 * (voxel_labels(truth, shape, size) == 0)
    hazy_job = replace(job, image=hazy.astype(np.float32))
    monkeypatch.undo()
    hazy_facts = facts_of(hazy_job, state, analyse_residual(image, grid, state))
    assert hazy_facts.cells[0].inside < -0.2
    assert hazy_facts.error.lacks
    assert hazy_facts.error.whole.alternative > 3 * facts.error.whole.noise
    # The same cell through a PSF of a third of its size: a membrane, or an inside?
    assert not facts.cells[0].small
    wide = replace(job, optics=nd.GaussianPSF(0.7))
    small = facts_of(wide, state, analyse_residual(image, grid, state))
    assert small.cells[0].small
    assert judged(replace(facts, cells=small.cells)).grade == "fair"
    told = run.model_copy(update={"fit": FitSettings(structure="membrane")})
    wide_told = replace(wide, settings=told)
    known = facts_of(wide_told, state, analyse_residual(image, grid, state))
    assert not known.cells[0].small
    moved = replace(state, mesh=state.mesh.translated((-0.85, 0, 0)))
    assert facts_of(job, moved, analyse_residual(image, grid, state)).cells[0].cut


@pytest.mark.parametrize(("top", "cut"), [(0.3, False), (-1.0, True)])
def test_a_cell_that_ends_just_within_the_image_is_not_cut_by_its_border(top, cut):
    """Voxels within its membrane and beyond it tell where it ends; top : voxels from the last."""
    size, middle = (0.2, 0.2, 0.2), (1.4 + 0.2 * top, 2.3, 2.3)
    grid, optics = nd.Grid((18, 24, 24), size), nd.GaussianPSF((0.24, 0.24, 0.24))
    whole = nd.Grid((28, 24, 24), size, (-2.0, 0.0, 0.0))
    image = nd.render(sphere(middle, 1.4, edge_length=0.3), whole, optics).numpy()[10:]
    image = np.random.default_rng(0).poisson(20 + 200 * image / image.max()).astype(np.float32)
    *_, state = fit(image, grid, sphere(middle, 1.25, edge_length=0.4), optics)
    end = state.mesh.vertices_numpy()[:, 0].min() / size[0]
    assert end == pytest.approx(top, abs=0.3)
    assert bool(cut_cells(state.mesh, grid)) is cut


@pytest.mark.slow
def test_what_lies_beyond_the_image_is_not_in_the_predicted_error():
    """A guess there is said to be one; its error would hide how well the rest is known."""
    size, middle = (0.2, 0.2, 0.2), (2.3, 2.3, 2.3)
    grid, optics = nd.Grid((24, 24, 24), size), nd.GaussianPSF((0.24, 0.24, 0.24))
    image = nd.render(sphere(middle, 1.5, edge_length=0.3), grid, optics).numpy()
    image = np.random.default_rng(0).poisson(20 + 200 * image / image.max()).astype(np.float32)
    upper = nd.Grid((13, 24, 24), size, (2.2, 0.0, 0.0))
    scene = SceneSettings(voxel_size=size, sigma=optics.sigma_um)
    run, start = RunSettings(image="", seeds="", scene=scene), sphere(middle, 1.4, edge_length=0.4)
    *_, state = fit(image[11:], upper, start, optics, settings=run.fit)
    job = FitInput(run, image[11:], upper, start, optics, None)
    assert 0.3 < (state.mesh.vertices_numpy()[:, 0] > 2.1).mean() < 0.7
    assert predicted_error(job, state).whole.total < 0.02
