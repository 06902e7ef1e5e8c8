"""The manifest is valid, and everything that it names does what it says."""

import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import napari_deltamic
from napari_deltamic.geometry.formats import MESH_FILES

MANIFEST = Path(napari_deltamic.__file__).with_name("napari.yaml")
npe2 = pytest.importorskip("npe2")


@pytest.fixture(scope="module")
def manifest():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return npe2.PluginManifest.from_file(MANIFEST)


def test_npe2_validates_the_manifest():
    command = "import sys; from npe2.cli import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", command, "validate", str(MANIFEST)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "valid" in done.stdout


def test_the_installed_package_brings_the_manifest():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = npe2.PluginManifest.from_distribution("napari-deltamic")
    assert found.contributions.widgets


def test_every_command_can_be_imported(manifest):
    pytest.importorskip("napari")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for command in manifest.contributions.commands:
            assert callable(npe2.manifest.utils.import_python_name(command.python_name))


def test_every_contribution_has_its_command(manifest):
    contributions = manifest.contributions
    known = {command.id for command in contributions.commands}
    used = {
        item.command
        for kind in ("readers", "writers", "sample_data", "widgets")
        for item in getattr(contributions, kind)
    }
    in_menus = {item.command for items in contributions.menus.values() for item in items}
    assert in_menus <= known
    # The rest are for the command palette alone.
    in_palette = {
        command.id for command in contributions.commands if ".gui.menu:" in command.python_name
    }
    assert used | in_menus | in_palette == known


def test_menus_are_some_that_plugins_may_add_to(manifest):
    menus = pytest.importorskip("napari._app_model.constants._menus")
    open_to_plugins = {str(menu) for menu in menus.MenuId.contributables()}
    assert set(manifest.contributions.menus) <= open_to_plugins


def test_a_session_can_be_dropped_into_napari(manifest):
    patterns = {p for reader in manifest.contributions.readers for p in reader.filename_patterns}
    assert "*.deltamic" in patterns
    assert patterns - {"*.deltamic"} == {f"*{suffix}" for suffix in MESH_FILES}


def test_every_mesh_file_can_be_written(manifest):
    assert set(manifest.contributions.writers[0].filename_extensions) == set(MESH_FILES)


@pytest.fixture(scope="module")
def layer():
    layers = pytest.importorskip("napari.layers")
    return layers.Layer.create


def test_every_sample_has_axes_and_units(manifest, layer):
    commands = {c.id: c.python_name for c in manifest.contributions.commands}
    for sample in manifest.contributions.sample_data:
        make = npe2.manifest.utils.import_python_name(commands[sample.command])
        for made in map(layer, *zip(*make(), strict=True)):
            assert made.axis_labels == ("z", "y", "x"), sample.key
            assert {str(unit) for unit in made.units} == {"micrometer"}
            assert made.name


def test_the_root_of_the_repository_shows_the_same_manifest():
    link = Path(__file__).parents[1] / "napari.yaml"
    if not link.exists():
        pytest.skip("not in a source tree")
    assert link.read_text() == MANIFEST.read_text()
