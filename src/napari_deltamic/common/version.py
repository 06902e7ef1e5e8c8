"""Versions of installed packages."""

from importlib.metadata import PackageNotFoundError, version


def version_of(package: str, missing: str = "unknown") -> str:
    """The version of an installed package; ``missing`` if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return missing


# There is none in a source tree that was never installed.
__version__ = version_of("napari-deltamic", "0+unknown")
