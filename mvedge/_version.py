"""Which version of the package this is."""

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """The version of `mvedge_jax`, or that it isn't known: sources run without an installation."""
    try:
        return version("mvedge_jax")
    except PackageNotFoundError:
        return "unknown (not installed)"
