"""A persistent cache of compiled programs."""

import os
from pathlib import Path

import jax

from ._stored import ProgramFiles, replaced_name, use


def compilation_cache(*, folder: str | os.PathLike | None = None) -> Path | None:
    """Switches on JAX's persistent compilation cache, for a notebook or a script.

    The first call of `depth` then takes seconds instead of half a minute from the second
    process on. `mvedge` does this by itself. A cache that was configured through JAX's own
    variables is left alone.

    The package's own programs are also stored as executables, in the subfolder `programs`: a later
    process does not trace them. Their key is everything they depend on: function, static fields,
    shapes, sources of the package, versions, device and processor, settings of JAX and the
    compiler. A program with parts of your own classes is not stored. `programs` is readable by the
    user's account alone (`mode 0700`), so that loading programs is safe, and holds at most 1 GiB.

    Args:
        folder: the cache folder; by default `MVEDGE_CACHE`, or `mvedge_jax/jax` in the user's
            cache folder.
            `"off"`, here or as `MVEDGE_CACHE`, switches nothing on.

    Returns:
        The folder in use, or None if there is none or it could not be made.

    Example:
        >>> compilation_cache(folder="off")
    """
    wish = os.environ.get("MVEDGE_CACHE", "") if folder is None else os.fspath(folder)
    if wish.lower() in {"off", "0", "no"}:
        return None
    configured = jax.config.values.get("jax_compilation_cache_dir")
    if configured and folder is None:
        return Path(configured)
    try:
        default = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mvedge_jax"
        path = Path(wish) if wish else default / "jax"
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # no home, or nothing may be written there
        return None
    if not os.access(path, os.W_OK):
        return None
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
    replaced_name()  # from now on, replaced ones are noticed
    use(ProgramFiles(path / "programs"))
    return path
