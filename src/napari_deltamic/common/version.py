"""Versions of what is installed; read when asked for, as that takes longer than the rest."""

from importlib.metadata import PackageNotFoundError, version


def version_of(package: str, missing: str = "unknown") -> str:
    """The version of an installed package; ``missing`` where there is none."""
    try:
        return version(package)
    except PackageNotFoundError:
        return missing


# Without one where it runs from a source tree that was never installed.
__version__ = version_of("napari-deltamic", "0+unknown")
