"""A session that is saved and opened in an empty viewer is the same, and goes on."""

import napari.components
import numpy as np
import pytest
from napari.layers import Labels, Surface

from napari_deltamic.fitting import fit
from napari_deltamic.geometry import sphere
from napari_deltamic.gui import fit_widget
from napari_deltamic.gui.running import worker
from napari_deltamic.images.stacks import write_image
from napari_deltamic.results.session_file import load_session
from napari_deltamic.runs.command import command
from napari_deltamic.runs.optics_settings import MeasuredOptics, optics_from_values
from napari_deltamic.scene.effects import Attenuation, Effects

from .conftest import CENTER
from .dialing import show_psf
from .interacting import went_on
from .sessions import done, fitted, save, shown

pytestmark = pytest.mark.usefixtures("judged")


@pytest.mark.slow
def test_psf_and_effects_come_back_with_what_was_fitted(seeded, spin, tmp_path, told, reopened):
    chosen = {"kind": "microscope", "na": 0.6, "wavelength": 0.6, "immersion": "water"}
    show_psf(seeded.doc, optics_from_values(chosen))
    seeded.doc.settings.show_effects(Effects.of(Attenuation(per_um=0.01)))
    seeded.settings.fit_psf.setChecked(True)
    seeded.settings.max_iterations.setValue(70)
    seeded.start()
    spin(done(seeded), seconds=60)
    save(seeded, tmp_path / "a.deltamic", spin)
    _, after = reopened(tmp_path / "a.deltamic")
    assert after.doc.settings.scene_settings() == seeded.doc.settings.scene_settings()
    one, other = seeded.doc.result.state, after.doc.result.state
    values = [p.value for p in one.optics.described()]
    assert [p.value for p in other.optics.described()] == pytest.approx(values, rel=1e-12)
    assert one.optics.described() != seeded.doc.result.job.optics.described()
    assert one.effects == other.effects
    assert after.running.numbers.texts() == seeded.running.numbers.texts()


def test_a_session_holds_the_image_of_its_bead(seeded, spin, tmp_path, told, reopened):
    z, y, x = (np.arange(21) - 10 for _ in range(3))
    bead = np.exp(-0.5 * (z[:, None, None] ** 2 / 9 + y[:, None] ** 2 / 4 + x**2 / 4))
    path = tmp_path / "bead.tif"
    write_image(path, (50 + 900 * bead).astype(np.float32), (0.1, 0.1, 0.1))
    show_psf(seeded.doc, MeasuredOptics(file=str(path)))
    seeded.settings.max_iterations.setValue(3)
    seeded.start()
    spin(done(seeded), seconds=60)
    before = seeded.doc.result.state.optics
    save(seeded, tmp_path / "a.deltamic", spin)
    path.unlink()
    _, after = reopened(tmp_path / "a.deltamic")
    assert after.doc.result.state.optics.sigma_um == pytest.approx(before.sigma_um)
    assert after.doc.settings.scene_settings().optics.build().sigma_um == pytest.approx(
        before.sigma_um
    )


def test_a_reopened_session_is_the_same(seeded, with_image, spin, tmp_path, told, reopened):
    with_image.layers["cell"].contrast_limits = (120, 333)
    with_image.layers["cell"].colormap = "viridis"
    before = fitted(seeded, spin)
    before.doc.look("rendered")
    spin(lambda: "cell: rendered" in with_image.layers)  # rendered in the background
    with_image.dims.set_point(0, 4.0)
    save(before, tmp_path / "a.deltamic", spin)
    assert told[-1] == f"saved {tmp_path / 'a.deltamic'}"
    viewer, after = reopened(tmp_path / "a.deltamic")
    assert shown(after) == shown(before)
    spin(lambda: "cell: rendered" in viewer.layers)
    names = {layer.name for layer in viewer.layers}
    assert names == {layer.name for layer in with_image.layers}
    for name in names:
        one, other = viewer.layers[name], with_image.layers[name]
        assert type(one) is type(other)
        assert tuple(one.scale) == tuple(other.scale)
        assert tuple(one.translate) == tuple(other.translate)
        assert one.units == other.units
        assert one.visible == other.visible
    image, old = viewer.layers["cell"], with_image.layers["cell"]
    assert image.data.tobytes() == old.data.tobytes()
    assert image.data.dtype == old.data.dtype
    assert tuple(image.contrast_limits) == (120, 333)
    assert image.colormap.name == "viridis"
    seeds = viewer.layers["seeds"]
    np.testing.assert_array_equal(seeds.data, with_image.layers["seeds"].data)
    np.testing.assert_array_equal(seeds.size, with_image.layers["seeds"].size)
    for k in range(2):
        np.testing.assert_array_equal(
            viewer.layers["cell: surfaces"].data[k], with_image.layers["cell: surfaces"].data[k]
        )
    assert viewer.dims.point[-3:] == pytest.approx(with_image.dims.point[-3:])
    np.testing.assert_allclose(
        viewer.layers["cell: contours"].data, with_image.layers["cell: contours"].data
    )
    np.testing.assert_allclose(
        viewer.layers["cell: rendered"].data, with_image.layers["cell: rendered"].data, rtol=1e-4
    )


def test_the_names_of_axes_come_back(seeded, with_image, spin, tmp_path, reopened):
    for layer in with_image.layers:
        layer.axis_labels = ("z", "y", "x")
    save(seeded, tmp_path / "a.deltamic", spin)
    viewer, _ = reopened(tmp_path / "a.deltamic")
    assert [tuple(layer.axis_labels) for layer in viewer.layers] == [("z", "y", "x")] * 2
    assert tuple(viewer.dims.axis_labels) == tuple(with_image.dims.axis_labels)


def test_a_psf_that_the_image_tells_stays_one(seeded, spin, tmp_path, reopened, pixels):
    assert seeded.doc.settings.psf_is_open
    save(seeded, tmp_path / "a.deltamic", spin)
    _, after = reopened(tmp_path / "a.deltamic")
    assert "as wide as the blur" in after.settings.psf_line.text()
    assert after.doc.settings.sigma == seeded.doc.settings.sigma
    assert "--sigma" not in command(after.doc.run_settings(), "result")
    after.settings.sigma._boxes[0].setValue(0.5)
    save(after, tmp_path / "b.deltamic", spin)
    _, after = reopened(tmp_path / "b.deltamic")
    assert "--sigma 0.5" in command(after.doc.run_settings(), "result")


def test_saving_again_gives_the_same_session(seeded, spin, tmp_path, reopened):
    save(fitted(seeded, spin), tmp_path / "a.deltamic", spin)
    _, widget = reopened(tmp_path / "a.deltamic")
    save(widget, tmp_path / "b.deltamic", spin)
    a, b = (load_session(tmp_path / name) for name in ("a.deltamic", "b.deltamic"))
    assert a.settings == b.settings
    assert a.panels == b.panels
    assert a.image.display == b.image.display
    assert [s.name for s in a.seeds] == [s.name for s in b.seeds]
    for one, other in zip(a.seeds, b.seeds, strict=True):
        for key in one.arrays:
            np.testing.assert_array_equal(one.arrays[key], other.arrays[key])
    assert a.result.history == b.result.history
    assert (a.result.verdict, a.result.message) == (b.result.verdict, b.result.message)
    assert a.result.seconds == b.result.seconds
    for part in ("state", "start"):
        one, other = (getattr(r, part) for r in (a.result, b.result))
        one, other = (getattr(r, "mesh", r) for r in (one, other))
        np.testing.assert_array_equal(one.vertices, other.vertices)
    told = [[(m.iteration, m.loss, m.note) for m in r.moments] for r in (a.result, b.result)]
    assert told[0] == told[1] != []  # a quick fit may have shown only its last state


def test_a_reopened_session_goes_on(seeded, spin, tmp_path, reopened):
    """A new run, one from an earlier moment, files, and clicks on the table."""
    save(fitted(seeded, spin), tmp_path / "a.deltamic", spin)
    viewer, widget = reopened(tmp_path / "a.deltamic")
    layers = len(viewer.layers)
    widget.results.save_all(str(tmp_path / "all"))
    assert (tmp_path / "all" / "report.json").exists()
    widget.running.history.slider.setValue(0)
    viewer.dims.ndisplay = 3
    first = widget.doc.timeline.moments[0]
    np.testing.assert_allclose(
        viewer.layers["cell: surfaces"].data[0], first.mesh.vertices_numpy(), atol=1e-5
    )
    before = len(widget.doc.timeline.moments)
    widget.running.history.go_on()
    spin(lambda: widget.doc.run is not None and not widget.doc.run.running)
    assert len(widget.doc.timeline.moments) > before
    assert widget.running.verdict.text().startswith("stopped after 12")
    widget.settings.max_iterations.setValue(9)
    widget.start()
    spin(done(widget))
    assert widget.running.verdict.text().startswith("stopped after 9")
    assert len(viewer.layers) == layers


def test_while_a_fit_runs_its_newest_state_is_saved(seeded, spin, tmp_path, monkeypatch, reopened):
    def states(job):
        while True:
            yield from fit(job.image, job.grid, job.mesh, job.optics, settings=job.settings.fit)

    monkeypatch.setattr(worker, "start", states)
    seeded.start()
    spin(went_on(seeded))
    save(seeded, tmp_path / "a.deltamic", spin)
    assert seeded.doc.run.running
    session = load_session(tmp_path / "a.deltamic")
    assert session.result.verdict == "stopped"
    assert len(session.result.history.loss) >= 5
    seeded.stop()
    spin(done(seeded))


def test_sessions_are_not_opened_over_a_running_fit(seeded, with_image, spin, tmp_path, told):
    save(fitted(seeded, spin), tmp_path / "a.deltamic", spin)
    seeded.doc.work.task = seeded.doc.run  # as if it still ran
    n = len(with_image.layers)
    seeded.sessions.open(str(tmp_path / "a.deltamic"))
    spin(lambda: not seeded.sessions.busy)
    assert "stop it" in told[-1]
    assert len(with_image.layers) == n
    seeded.doc.work.task = None


def test_seeds_of_all_kinds_come_back(make_widget, with_image, spin, tmp_path, reopened):
    widget, image = make_widget(), with_image.layers["cell"]
    labels = np.zeros(image.data.shape, np.uint16)
    labels[5:9, 5:9, 5:9] = 3
    place = {"scale": image.scale, "translate": image.translate, "units": image.units}
    with_image.add_layer(Labels(labels, name="painted", **place))
    ball = sphere(CENTER, 0.5)
    regions = np.tile([4, 0], (len(ball.faces), 1))
    with_image.add_layer(
        Surface(
            (ball.vertices, ball.faces),
            name="ball",
            metadata={"deltamic": {"regions": regions}},
            **widget.doc.image.frame().layer_options(),
        )
    )
    with_image.add_points([[0, 0, 0]], name="not ticked")
    widget.seeds.cells.choose(with_image.layers["not ticked"], False)
    save(widget, tmp_path / "a.deltamic", spin)
    viewer, after = reopened(tmp_path / "a.deltamic")
    assert [layer.name for layer in after.seeds.cells.ticked] == ["painted", "ball"]
    np.testing.assert_array_equal(viewer.layers["painted"].data, labels)
    assert viewer.layers["painted"].data.dtype == np.uint16
    frame = after.doc.image.frame()
    pixels, grid = after.doc.image.stack(), frame.grid(image.data.shape)
    docs = widget.doc, after.doc
    one, other = (d.cells.seeds(d.image.frame()).make(pixels, grid) for d in docs)
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.regions, other.regions)
    assert not after.results.isEnabled()


def test_of_a_series_the_time_that_is_shown_is_saved(app, pixels, spin, tmp_path, reopened):
    viewer = napari.components.ViewerModel()
    viewer.add_image(np.stack([0 * pixels, pixels]), scale=(1, 0.3, 0.2, 0.2), name="film")
    viewer.add_points([[0, 1, 1, 1], [1, 2, 2, 2]], name="seeds", size=1.5)
    viewer.dims.set_current_step(0, 1)
    widget = fit_widget.FitWidget(viewer)
    save(widget, tmp_path / "a.deltamic", spin)
    widget.close_links()
    after, _ = reopened(tmp_path / "a.deltamic")
    np.testing.assert_array_equal(after.layers["film"].data, pixels)
    np.testing.assert_array_equal(after.layers["seeds"].data, [[2, 2, 2]])
    assert tuple(after.layers["film"].scale) == (0.3, 0.2, 0.2)
