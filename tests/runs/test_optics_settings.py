"""A PSF in run.toml: every kind comes back as it was, and what is wrong is said in one line."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic import InputError
from napari_deltamic.fitting.job import optics_of
from napari_deltamic.images.stacks import write_image
from napari_deltamic.runs.optics_settings import optics_from_toml, optics_from_values
from napari_deltamic.runs.settings import RunSettings, SceneSettings, validated

VOXEL = (0.2, 0.1, 0.1)
KINDS = [
    ({"kind": "gaussian", "sigma": (0.3, 0.1, 0.1)}, nd.GaussianPSF),
    (
        {"kind": "mixture", "sigmas": ((0.3, 0.1, 0.1), (0.6, 0.3, 0.3)), "masses": (1.0, 0.3)},
        nd.GaussianMixturePSF,
    ),
    (
        {"kind": "microscope", "modality": "confocal", "na": 1.1, "wavelength": 0.52,
         "immersion": "water", "excitation": 0.488},
        nd.ConfocalPSF,
    ),
    (
        {"kind": "microscope", "na": 0.8, "wavelength": 0.52, "immersion": 1.0,
         "model": "pupil", "zernike": {5: 0.2, 11: -0.1}, "fitted": ("z5",)},
        nd.PupilPSF,
    ),
]  # fmt: skip


@pytest.mark.parametrize(("values", "kind"), KINDS)
def test_every_kind_survives_run_toml(tmp_path, values, kind):
    scene = {"voxel_size": VOXEL, "optics": values}
    settings = validated(RunSettings, {"image": "a.tif", "seeds": "s.ply", "scene": scene})
    path = tmp_path / "run.toml"
    path.write_text(settings.to_toml())
    again = RunSettings.from_toml(path)
    assert again == settings
    built = optics_of(again.scene)
    assert isinstance(built, kind)
    assert [p.value for p in built.described()] == [
        p.value for p in optics_of(settings.scene).described()
    ]


def test_a_measured_psf_takes_its_voxel_size_from_its_file(tmp_path):
    grids = np.meshgrid(*(np.arange(n) - n // 2 for n in (21, 25, 25)), indexing="ij")
    image = 10 + 500 * np.exp(-sum((g / 2.0) ** 2 for g in grids) / 2)
    write_image(tmp_path / "bead.tif", image.astype(np.float32), VOXEL)
    (tmp_path / "psf.toml").write_text('kind = "measured"\nfile = "bead.tif"\n')
    psf = optics_from_toml(tmp_path / "psf.toml").build()
    assert psf.sigma_um == pytest.approx([2 * d for d in VOXEL], rel=0.05)
    np.save(tmp_path / "bead.npy", image)
    (tmp_path / "psf.toml").write_text('kind = "measured"\nfile = "bead.npy"\n')
    with pytest.raises(InputError, match="does not say its voxel size"):
        optics_from_toml(tmp_path / "psf.toml").build()


def test_sigma_stays_the_short_way():
    psf = optics_of(SceneSettings(voxel_size=VOXEL, sigma=(0.3, 0.1, 0.1)))
    assert psf.sigma_um == (0.3, 0.1, 0.1)
    assert optics_of(SceneSettings(voxel_size=VOXEL)).sigma_um == pytest.approx((0.24, 0.12, 0.12))


def test_two_psfs_are_refused():
    scene = {"voxel_size": VOXEL, "sigma": (1, 1, 1), "optics": KINDS[0][0]}
    with pytest.raises(InputError, match="give one of them"):
        validated(SceneSettings, scene)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"kind": "laser"}, "laser"),
        ({"kind": "microscope", "na": 1.0}, "wavelength"),
        ({"kind": "microscope", "na": 1.0, "wavelength": 0.5, "colour": "red"}, "colour"),
    ],
)
def test_wrong_settings_are_named(values, reason):
    with pytest.raises(InputError, match=reason):
        optics_from_values(values)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot read optics"):
        optics_from_toml(tmp_path / "none.toml")
