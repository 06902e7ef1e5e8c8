"""What holds for every PSF model: gradients, normalisation, symmetry, parameters."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from napari_deltamic import InputError, optics

from .models import EXTENT, MODELS, axes, pupil, scalar

EVERY = [
    (kind, p.name) for kind, make in MODELS.items() for p in make().described()
]  # every parameter of every model


def probe(otf):
    """A number that hangs on the whole OTF, real and imaginary part."""
    weight = torch.linspace(0.3, 1.7, otf.numel(), dtype=torch.float64).reshape(otf.shape)
    value = (otf.real * weight).sum()
    return value + (otf.imag * weight.flip(0)).sum() if otf.is_complex() else value


@pytest.mark.parametrize(("kind", "name"), EVERY)
def test_gradient_by_every_parameter_is_right_to_five_digits(kind, name):
    make = MODELS[kind]
    start = {p.name: p.value for p in make().described()}[name]

    def at(value):
        return probe(make(**{name: value}).otf(axes()))

    value = torch.tensor(start, dtype=torch.float64, requires_grad=True)
    (found,) = torch.autograd.grad(at(value), value)
    h = 1e-3 * max(abs(start), 0.1)
    if name in ("coverslip", "design_coverslip", "working_distance"):
        h = 0.05  # um: the image hangs on their differences
    # Nodes are placed for the value that a model is made with; so all are made at the start.
    model = make(**{name: value.detach()})

    def moved(step):
        values = {**model.values, name: value.detach() + step}
        return float(probe(model._with_values(values).otf(axes())))

    steps = [(moved(s * h) - moved(-s * h)) / (2 * s * h) for s in (1, 0.5)]
    expected = (4 * steps[1] - steps[0]) / 3
    assert float(found) == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("kind", MODELS)
def test_the_psf_is_real_and_its_sum_is_one(kind):
    otf = MODELS[kind]().otf(axes((-2.0, 0.0, 2.0), (-5.0, 0.0, 5.0), (-4.0, 0.0, 4.0)))
    assert complex(otf[1, 1, 1]) == pytest.approx(1, abs=1e-12)
    assert_allclose(otf.flip(0, 1, 2).conj().resolve_conj().numpy(), otf.numpy(), atol=1e-12)
    assert float(otf.abs().max()) <= 1 + 1e-9


@pytest.mark.parametrize("kind", MODELS)
def test_no_light_beyond_the_support(kind):
    model = MODELS[kind]()
    ends = getattr(model, "_needed", model.support)()
    for axis, end in enumerate(ends):
        # Off the Z axis, where the light of all planes adds up to the transform of their window.
        k = [torch.zeros(1, dtype=torch.float64) for _ in range(3)]
        k[1 if axis != 1 else 2][:] = 0.45 * ends[2]
        k[axis] = torch.linspace(1.1 * end, 3 * end, 40, dtype=torch.float64)
        z, y, x = k
        beyond = model.otf((z[:, None, None], y[None, :, None], x[None, None, :]))
        assert float(beyond.abs().max()) < 5e-3


def test_parameters_come_back_from_the_numbers_of_a_fit():
    for kind, make in MODELS.items():
        free = [p.name for p in make().described() if not p.refused]
        model = make(fitted=free)
        again = model.with_parameters(model.parameters())
        for p, q in zip(model.described(), again.described(), strict=True):
            assert q.value == pytest.approx(p.value, rel=1e-12), (kind, p.name)
            assert p.fitted == (p.name in free)


@pytest.mark.parametrize("step", [-15.0, 15.0])
def test_no_number_of_a_fit_leaves_the_bounds(step):
    model = scalar(fitted=("na", "wavelength", "apodisation"))
    p = model.parameters()
    values = model.with_parameters(p + step * torch.tensor([1.0, 0.0, 0.0])).values
    assert 0 < float(values["na"]) <= float(values["index"])
    values = model.with_parameters(p + torch.tensor([0.0, 0.1 * step, 0.0])).values
    assert float(values["wavelength"]) > 0


def test_limits_hold_the_start():
    for make in MODELS.values():
        model = make(fitted=[p.name for p in make().described() if not p.refused])
        low, high = model.limits()
        p = model.parameters()
        assert bool(((low < p) & (p < high)).all())


@pytest.mark.parametrize("kind", ["gibson-lanni", "vectorial"])
def test_scale_of_z_is_refused_with_the_reason(kind):
    with pytest.raises(InputError, match=r"sample_index cannot be fitted: .*scale of z"):
        MODELS[kind](fitted=("sample_index",))


@pytest.mark.parametrize(("noll", "reason"), [(2, "translation"), (3, "tilt"), (4, "defocus")])
def test_translations_are_refused_with_the_reason(noll, reason):
    with pytest.raises(InputError, match=reason):
        optics.PupilPSF(0.9, 0.52, 1.0, {noll: 0.1})


def test_unknown_parameter_is_named():
    with pytest.raises(InputError, match="no parameter 'tilt' to fit"):
        scalar(fitted=("tilt",))


def test_an_otf_is_computed_once_while_nothing_changes():
    model, k = scalar(), axes()
    assert model.otf(k) is model.otf(k)
    assert model.detach().otf(k) is not model.otf(k)


@pytest.mark.parametrize("kind", ["scalar", "vectorial", "pupil", "confocal", "light sheet"])
def test_a_larger_na_gets_more_nodes(kind):
    make = MODELS[kind]
    model = make(na=0.5)
    wide = model._with_values({**model.values, "na": torch.tensor(0.95, dtype=torch.float64)})
    assert_allclose(wide.otf(axes()).numpy(), make(na=0.95).otf(axes()).numpy(), atol=2e-5)


def test_single_precision_axes_give_a_single_precision_otf():
    k = tuple(a.float() for a in axes())
    for make in MODELS.values():
        assert make().otf(k).dtype in (torch.float32, torch.complex64)


def test_extent_beyond_which_nothing_is():
    z = torch.linspace(-4, 4, 41, dtype=torch.float64)
    x = torch.zeros(1, dtype=torch.float64)
    along = scalar(extent=EXTENT).density(z, x, x).reshape(-1).numpy()
    assert np.abs(along[np.abs(z.numpy()) > 2 * EXTENT[0] + 0.2]).max() < 1e-3 * along.max()


def test_sharpened_is_sharper_where_it_is_fitted():
    far = axes((0.0,), (0.0,), (25.0,))
    free, held = scalar(fitted=("na",)), scalar()
    assert float(free.sharpened(0.9).otf(far).real) > 1.2 * float(held.otf(far).real) > 0
    assert float(pupil(fitted=("z5",)).sharpened(0.9).otf(far).abs()) == float(
        pupil(fitted=("z5",)).otf(far).abs()
    )


@pytest.mark.parametrize("kind", ["scalar", "confocal"])
def test_a_fit_may_find_a_wavelength_longer_than_light(kind):
    longer = {"na": 1.1, "wavelength": 2.7} | ({"excitation": 2.5} if kind == "confocal" else {})
    begun = MODELS[kind](na=0.3, wavelength=1.9)
    moved = {name: torch.tensor(v, dtype=torch.float64) for name, v in longer.items()}
    found = begun._with_values({**begun.values, **moved})  # so sharp that nodes are placed anew
    made = MODELS[kind](**longer)  # as settings that are read again
    assert_allclose(found.otf(axes()).numpy(), made.otf(axes()).numpy(), atol=1e-4)


@pytest.mark.parametrize("made", ["scalar", "confocal", "light sheet"])
def test_there_and_back_it_is_the_same(made):
    """Planes are kept by values, and nodes may be others by then."""
    objective = optics.ScalarPSF(0.8, 0.5, 1.33)
    first = {
        "scalar": objective,
        "confocal": optics.ConfocalPSF(objective, 0.45),
        "light sheet": optics.LightSheetPSF(objective, 2.0),
    }[made]
    axes = [torch.linspace(-20, 20, 9, dtype=torch.float64) for _ in range(3)]
    box = axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None]
    before = first.otf(box)
    start = first.parameters()
    for further in (0.1, 0.2, 0.4, 0.8):
        there = first.with_parameters(start + further)
        there.otf(box)
        back = there.with_parameters(start).otf(box)
        assert float((back - before).abs().max()) < 0.02
