"""What becomes of light: sensor noise, lenses, blur, edges of pixels, shadows, gloss, textures."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from datasets.test_synthetic import KEY, PICTURE, SMALL, rays, render, warp
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.synthetic import _trace
from mvedge_jax.datasets.synthetic.world import Material

pytestmark = pytest.mark.usefixtures("optimized")
PLAIN = Material(dark=(0.5, 0.5, 0.5), light=(0.5, 0.5, 0.5), contrast=0.0)
DARK = replace(PLAIN, dark=(0.1, 0.1, 0.1), light=(0.1, 0.1, 0.1))
BLACK = replace(PLAIN, dark=(0.0, 0.0, 0.0), light=(0.0, 0.0, 0.0))
ROW, SINGLE = (1, 3, *SMALL[2:]), (1, 1, *SMALL[2:])


def scene_of(*solids, light=None, **sensor):
    given: dict[str, Any] = {"shadow": 0.0, **(light or {})}
    world = synthetic.make_world(list(solids), **given)
    return synthetic.make_scene(world, disparity_range=(-5.0, 5.0), **sensor)


def gray(edge=2.0, material=DARK, **sensor):
    """A plain wall, before whose right half there is a dark card."""
    wall = synthetic.plane((0.0, 0.0, 4.0001), (99.0, 99.0), material=PLAIN)
    card = synthetic.plane((edge, 0.0, 4.0), (4.0, 99.0), material=material)
    return scene_of(wall, card, **sensor)


def linear(image):
    """Inverse of the sRGB curve."""
    image = np.asarray(image, float)
    return np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)


def thrice(scene):
    """The same key twice, and another one."""
    first, same, other = (render(scene, ROW, key=key) for key in (KEY, KEY, jax.random.key(1)))
    assert_array_equal(first.views, same.views)
    return first.views, other.views


def test_sensor_noise_has_the_stated_variance_and_its_own_draw_per_view():
    clean = render(gray(), ROW).views
    noisy, other = thrice(gray(read_noise=0.02, shot_noise=0.001))
    noise = np.asarray(noisy - clean)
    for level in np.unique(np.round(clean[0, 1, :, [5, 48]], 4)):
        where = np.abs(np.asarray(clean) - level) < 1e-3
        assert abs(noise[where].std() / np.sqrt(0.02**2 + 0.001 * level) - 1) < 0.05
        assert abs(noise[where].mean()) < 0.001
    assert abs(np.corrcoef(noise[0, 0].ravel(), noise[0, 1].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(noise.ravel(), np.asarray(other - clean).ravel())[0, 1]) < 0.05


def test_lenses_of_uneven_brightness_are_another_in_every_view():
    """Against the closed form: a paraboloid that is 1 at its own center."""
    clean = render(gray(), ROW).views
    uneven, other = thrice(gray().through_lenses(vignette=0.4, vignette_shift=0.05, gain=0.02))
    assert float(jnp.abs(other - uneven).max()) > 0.01
    size = np.array(ROW[2:]) - 1
    y, x = np.mgrid[: ROW[2], : ROW[3]] - size[:, None, None] / 2
    square = 4 * (x**2 + y**2) / (size @ size)
    basis = np.stack([np.ones_like(square), x, y, square], axis=-1).reshape(-1, 4)
    gains, centers = [], []
    for view in np.asarray(uneven / clean)[0]:
        fit, *_ = np.linalg.lstsq(basis, view[..., 0].ravel(), rcond=None)
        assert_allclose(basis @ fit, view[..., 0].ravel(), atol=1e-5)
        assert fit[3] / fit[0] == pytest.approx(-0.4, rel=0.03)
        gains.append(fit[0])
        centers.append(fit[1:3] / fit[0])
    assert 0.002 < np.std(gains) < 0.08
    assert np.ptp(centers, axis=0).max() > 1e-3
    plain = gray().through_lenses(vignette=0.0, gain=0.0)
    assert_array_equal(render(plain, ROW).views, clean)


def test_blur_has_the_stated_width():
    sharp, soft = (linear(render(gray(blur=b), SINGLE).center_view) for b in (0.0, 1.7))

    def width(image):
        edge = -np.diff(image[16, 15:39, 1])
        weight, x = edge / edge.sum(), np.arange(len(edge))
        return weight @ (x - weight @ x) ** 2

    assert_allclose(width(soft) - width(sharp), 1.7**2, rtol=0.02)
    assert_allclose(soft.mean(), sharp.mean(), rtol=1e-3)


def test_edges_are_antialiased():
    """A pixel on an edge is the mix of what its samples see, spread like a tent."""
    width = PICTURE[3]
    edge = 2.0 + 0.3 * 4 / (1.4 * width)  # 0.3 px right of the middle, at depth 4
    image = render(gray(edge, BLACK), (1, 1, *PICTURE[2:]), samples=3).center_view
    row = linear(image)[7, :, 1]
    position = (width - 1) / 2 + 0.3 - np.arange(width)  # of the edge, from the pixel's center
    expected = (position[:, None] > _trace.tent(3)).mean(-1)
    assert_allclose(row / row[0], expected, atol=1e-4)
    assert len(np.unique(expected)) > 2


def test_shadows_darken_and_are_optional():
    wall = synthetic.plane((0.0, 0.0, 6.0), (99.0, 99.0), material=PLAIN)
    ball, lamp = synthetic.sphere((0.0, 0.0, 4.5), 0.4, material=PLAIN), (-0.3, -0.3, -0.9)
    dark, light = (
        render(scene_of(wall, ball, light={"lamp": lamp, "shadow": s, "dtype": jnp.float64}))
        for s in (1.0, 0.0)
    )
    difference = np.asarray(light.center_view - dark.center_view)[..., 1]
    on_wall = np.asarray(light.truth.object_ids) == 1
    assert difference.min() >= -1e-9
    # The shadow of the ball, from the closed form of a parallel projection along the lamp.
    offset = rays(SMALL, 1, 2)[1] * 6.0 - np.array([0.0, 0.0, 4.5])
    distance = np.linalg.norm(np.cross(offset, np.array(lamp) / np.linalg.norm(lamp)), axis=-1)
    assert (difference > 0.05)[on_wall & (distance < 0.35)].all()
    assert_allclose(difference[on_wall & (distance > 0.5)], 0.0, atol=1e-9)
    assert (on_wall & (distance < 0.35)).sum() > 10


def test_further_lamps_brighten_and_cast_no_shadow():
    card, fill = synthetic.plane((0.0, 0.0, 4.0), (9.0, 9.0)), ((0.3, -0.2, -1.0), (0.2, 0.2, 0.2))
    dark, lit = (
        render(scene_of(card, light={"shadow": 1.0, "lamp_strength": 0.0, "fills": fills}), SINGLE)
        for fills in ([], [fill])
    )
    assert float(lit.center_view.mean()) > 1.1 * float(dark.center_view.mean())


def test_only_specular_surfaces_change_with_the_view():
    def error(**changes):
        wall = synthetic.plane((0.0, 0.0, 6.0), (99.0, 99.0), material=PLAIN)
        ball = synthetic.sphere((0.0, 0.0, 3.6), 0.9, material=replace(PLAIN, **changes))
        scene = synthetic.make_scene(
            synthetic.make_world([wall, ball]), disparity_range=(-5.0, 5.0)
        )
        field = render(scene, PICTURE, samples=3)
        views = np.asarray(field.views, float) * 255
        warped = warp(field, (1, 0), (1, 2), views[1, 2])
        seen = synthetic.visibility(scene, shape=PICTURE, source=(1, 0), target=(1, 2))
        on_ball = np.asarray(seen) & (np.asarray(field.truth.view_ids[1, 0]) == 2)
        return np.percentile(np.abs(warped - views[1, 0])[on_ball], 97)

    assert error() < 1.0
    assert error(specular=0.9, mirror=0.3) > 5.0
