"""Depth in tiles is that of the whole image, wherever views say it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from datasets.layouts import known
from depth.test_edge_depth import small_model, small_scene
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax import EdgeDepth
from mvedge_jax.depth import estimate_depth
from mvedge_jax.depth.steps import label_part
from mvedge_jax.photometry import Calibrate
from mvedge_jax.photometry.brightness import Exposure, Known
from mvedge_jax.tiles import StoredViews, Tiling, Window, depth_in_tiles


@pytest.fixture(scope="module")
def scene():
    """That of `depth/test_edge_depth.py`, for its program."""
    return small_scene()


@pytest.fixture(scope="module")
def wide():
    """Wide enough that a pixel's surroundings lie within a tile."""
    return small_scene(shape=(3, 3, 40, 200))


@pytest.mark.parametrize(("height", "width"), [(100, 64), (64, 64), (40, 301)])
def test_every_pixel_is_in_one_core_and_away_from_inner_borders(height, width):
    counts, tiling = np.zeros((height, width), int), Tiling(side=64, overlap=16)
    shapes = set()
    for window, core in tiling.of(height, width):
        core.of(counts)[...] += 1
        shapes.add((window.height, window.width))
        assert window.top % 4 == window.left % 4 == 0
        for near, far, start, stop, length in (
            (window.top, window.top + window.height, core.top, core.top + core.height, height),
            (window.left, window.left + window.width, core.left, core.left + core.width, width),
        ):
            assert near == 0 or start - near >= 8
            assert far == length or far - stop >= 8
    assert (counts == 1).all()
    assert len(shapes) == 1
    assert (np.asarray([*shapes][0]) <= (min(64, height), min(64, width))).all()


def test_tiles_are_as_small_as_their_number_allows():
    tiles = Tiling(side=1152, overlap=96).of(2048, 1500)
    assert {(window.height, window.width) for window, _ in tiles} == {(1076, 804)}
    assert len(tiles) == 4


def test_tilings_that_cannot_be():
    with pytest.raises(ValueError, match="at least twice `overlap`"):
        Tiling(side=64, overlap=48).of(100, 100)
    with pytest.raises(ValueError, match="`memory` must be at least .* got 0.5 GB"):
        Tiling.within(0.5e9)
    image = np.zeros((4000, 4000, 3), np.uint8)
    views = StoredViews({(0, u): image for u in range(3)}, (1, 3))
    sides = [Tiling.within(2e9), Tiling.within(12e9, views=views), Tiling.within(12e9)]
    assert sides[0].side < sides[1].side < sides[2].side
    with pytest.raises(ValueError, match="`memory` must be at least 11 GB"):
        Tiling.within(10e9, views=views)  # its tiles would fit, the diffusion does not


def test_windows_hold_what_the_light_field_holds(scene):
    stored = StoredViews.of(scene)
    part = stored.window(Window(4, 8, 20, 30))
    cross = np.asarray(part.available)
    assert cross.sum() == 9
    assert_array_equal(part.views[cross], np.asarray(scene.views)[cross][:, 4:24, 8:38])
    assert not np.asarray(part.views)[~cross].any()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colors_stay_in_their_bits(dtype):
    white = np.iinfo(dtype).max
    image = np.random.default_rng(0).integers(0, white, (6, 8, 3)).astype(dtype)
    stored = StoredViews({(0, u): image for u in range(3)}, (1, 3))
    part = stored.window(Window(0, 0, 6, 8))
    assert_allclose(part.views[0, 1], image / white, rtol=1e-6)
    assert_allclose(stored.center_view, image / white, rtol=1e-6)


def test_colors_that_are_none_are_refused():
    image = np.full((6, 8, 3), 0.5, np.float32)
    for wrong in (-0.5, 1.5, np.nan):
        planes = {(0, 0): image, (0, 1): image, (0, 2): np.where(image > 0, wrong, 0)}
        with pytest.raises(ValueError, match=rf"in \[0, 1\], got .*{wrong:g} in view .*\(0, 2\)"):
            StoredViews(planes, (1, 3))


def test_small_pictures_average_areas():
    values = np.arange(1024 * 1030 * 3, dtype=np.float32).reshape(1024, 1030, 3) / 4e6
    stored = StoredViews({(0, u): values for u in range(3)}, (1, 3), disparity_range=(-2.0, 4.0))
    small, factor = stored.shrunk()
    assert factor == 2
    assert small.views.shape == (1, 3, 512, 515, 3)
    assert_allclose(small.views[0, 1, 3, 5], values[6:8, 10:12].mean((0, 1)), rtol=1e-6)
    assert_allclose(known(small.disparity_range), [-1, 2])


def test_the_vignette_of_a_part_is_that_part_of_the_vignette():
    vignette = 0.1 * jax.random.normal(jax.random.key(0), (3, 3, 4, 4), jnp.float64)
    exposure = Exposure(jnp.asarray(1.5), jnp.linspace(0.9, 1.1, 9).reshape(3, 3), vignette)
    whole = exposure.factors(..., (50, 70))
    part = exposure.within(11, 20, (24, 32), (50, 70)).factors(..., (24, 32))
    assert_allclose(part, whole[..., 11:35, 20:52], rtol=1e-12)


@pytest.mark.slow
def test_what_is_known_is_not_measured_again(scene):
    model = small_model(scene)
    measured = estimate_depth(scene.bare(), model)
    before = Known(measured.stats.exposure, measured.stats.noise)
    again = estimate_depth(scene.bare(), model.replace({"calibration.known": before}))
    # Not to all digits: the first map is searched for in views of the final exposure, too.
    assert np.median(np.abs(again.disparity - measured.disparity)) < 5e-3
    assert_array_equal(again.stats.exposure.gain, measured.stats.exposure.gain)
    louder = before.noise._replace(deviation=3 * before.noise.deviation)
    noisier = before._replace(noise=louder)
    other = estimate_depth(scene.bare(), model.replace({"calibration.known": noisier}))
    assert float(other.stats.noise.deviation) == pytest.approx(
        3 * float(measured.stats.noise.deviation)
    )


def _in_tiles_and_whole(field, model):
    """Depth in two tiles, and that of the whole with the brightness and the noise of these."""
    seen = []
    tiling = Tiling(side=124, overlap=40)
    tiled = depth_in_tiles(
        field, model=model, tiling=tiling, progress=lambda *now: seen.append(now)
    )
    if isinstance(model.calibration, Calibrate):
        known = Known(tiled.stats.exposure, tiled.stats.noise)
        model = model.replace({"calibration.known": known})
    assert seen == [(k + 1, len(seen)) for k in range(len(seen))]
    return tiled, model(field), len(seen)


def test_tiles_have_the_depth_of_the_image(wide):
    model, before = small_model(wide), label_part.traces
    tiled, whole, visits = _in_tiles_and_whole(wide, model)
    assert label_part.traces == before + 1, "tiles share a program"
    assert visits == 2 * (1 + len(whole.stats.iterations))
    for name in ("disparity", "error", "depth_edge"):
        ours, theirs = getattr(tiled, name), getattr(whole, name)
        assert ours.shape == theirs.shape
        apart = np.abs(ours - theirs)
        assert np.percentile(apart, 99) < 2e-6
        assert apart.max() < 1e-4
    assert_array_equal(tiled.stats.iterations, whole.stats.iterations)
    assert tiled.stats.converged
    assert tiled.points.valid.all()
    found, known = (
        np.asarray(points.xy)[np.asarray(points.valid)] for points in (tiled.points, whole.points)
    )
    assert len(found) == tiled.stats.edges.valid == len(tiled.surface.score)
    found, known = (xy[np.lexsort(xy.T)] for xy in (found, known))
    assert_array_equal(found, known)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["learned", "edges"])
def test_tiles_have_the_depth_of_the_image_by_every_preset(wide, preset):
    model = small_model(wide, preset=preset)
    tiled, whole, _ = _in_tiles_and_whole(wide, model)
    apart = np.abs(tiled.disparity - whole.disparity)
    assert np.percentile(apart, 99) < 1e-5
    assert apart.max() < 1e-3


def test_models_that_read_all_views_are_refused(scene):
    model = EdgeDepth.for_light_field(scene, views="all")
    with pytest.raises(ValueError, match="tiles have those of the crosshair"):
        depth_in_tiles(scene, model=model)
