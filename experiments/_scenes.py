"""Scenes by name: a path, a scene of the development data, or a synthetic one."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import jax

from mvedge_jax.datasets import load_light_field, synthetic
from mvedge_jax.edges import scene_range
from mvedge_jax.lightfield import LightField

# Of the development data: those of the benchmark, and ours with the truth of every view.
DEVELOPMENT = ("cotton", "backgammon", "room", "bench")
# Searched instead of a scene's own, px; the narrowest first.
RANGES = ((-1.6, 1.7), (-1.9, 1.9), (-2.3, 2.3))
_SYNTHETIC = ("edges", "thin", "wide", "noisy", "slanted", "crossing")


def stored(name: str, data: Path | None) -> Path | None:
    """Where a scene lies on disk: `name` as a path, or below `data` (`cotton`, `hci/cotton`)."""
    places = [Path(name)]
    if data is not None:
        places += [data / part / name for part in (".", "hci", "traced")]
    return next((place for place in places if place.exists()), None)


def find_scene(name: str, data: Path | None, *, size: int) -> LightField:
    """A light field by its path, its name in the development data, or that of a synthetic one.

    Args:
        name: which.
        data: folder of development data; None for paths and synthetic scenes only.
        size: side of the views of a synthetic scene, px; there are 9x9.
    """
    place = stored(name, data)
    if place is not None:
        return load_light_field(place)
    shape = (9, 9, size, size)
    return synthetic.render(synthetic.scene(name), shape=shape, key=jax.random.key(0))


def scenes(
    data: Path | None, names: Sequence[str], *, size: int
) -> Iterator[tuple[str, LightField]]:
    """Benchmark scenes that are on disk and synthetic ones, rendered with 9x9 views.

    Compiled programs are dropped after each: one of the whole chain takes 1300 memory maps, and the
    compiler crashes when a process has as many as Linux allows (65530).

    Args:
        data: folder of development data; None for paths and synthetic scenes only.
        names: which, see `find_scene`; empty for the benchmark's and the synthetic ones.
        size: side of the rendered views, px.
    """
    known = sorted(path.name for path in (data / "hci").glob("*/")) if data else []
    for name in names or (*known, *_SYNTHETIC):
        yield Path(name).name, find_scene(name, data, size=size)
        jax.clear_caches()


def common_range(light_field: LightField) -> tuple[float, float] | None:
    """The narrowest of `RANGES` that covers a scene's own; None if none does."""
    low, high = (round(limit, 4) for limit in scene_range(light_field))  # of float32
    return next((limits for limits in RANGES if limits[0] <= low and high <= limits[1]), None)


def over_common_range(light_field: LightField) -> LightField:
    """A scene that is searched over its common range, if there is one.

    Scenes of one size then share programs. Their figures differ from those with their own ranges:
    mostly in the third digit, on single scenes by up to a third.
    """
    return light_field.with_range(*(common_range(light_field) or scene_range(light_field)))
