"""Depth from posed photographs: of walls whose depth is known, and what may be wrong with them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces, shared_data
from posed.walls import MATRIX, POSES, SIZE, falloff, places, texture, turned, wall

from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.photographs import load_photographs
from mvedge_jax.photometry.brightness import Brightness, PosedViews
from mvedge_jax.posed import Photographs, StereoDepth, _stereo, reference_of, stereo
from mvedge_jax.posed._problems import depth_problems
from mvedge_jax.posed.cloud import photographs_of, surface_of
from mvedge_jax.posed.scores import depth_errors

IMAGES, DEPTHS = wall(POSES)
RANGE = (1.2, 3.5)
_QUICK = {"refine.solves": 1, "refine.sharpen.levels": 8}
BLACK = np.zeros((2, 8, 8, 3))


def photographs(images=IMAGES, poses=POSES, dtype=jnp.float64, **known):
    return Photographs(jnp.asarray(images, dtype), poses, MATRIX, **known)


def wanted_of(view, index: int | str = 0, depth_range: Any = RANGE):
    return reference_of(view, index, depth_range=depth_range)


def median_error(found, index=0):
    """Percent."""
    return float(depth_errors(found.depth, jnp.asarray(DEPTHS[index])).median)


@pytest.fixture(scope="module")
def small():
    """A model for quick programs, and the compiled one."""
    model = StereoDepth.of(wanted_of(photographs()), choices=_QUICK)
    run, traces = count_traces(lambda p, reference: stereo(p, reference, model))
    return (lambda view, index=0, **k: run(view, wanted_of(view, index, **k))), traces


def test_finds_the_wall_from_every_photograph_with_one_program(small):
    run, traces = small
    for index in range(4):
        found = run(photographs(), index)
        # In the farthest photograph, four baselines away, px: .022 and .136 on 25 November.
        truth = float(wanted_of(photographs(), index).scale(photographs())) / DEPTHS[index]
        off = 4 * np.abs(np.asarray(found.disparity) - truth)
        assert np.median(off) < 0.024
        assert np.quantile(off, 0.9) < 0.15
        assert bool(jnp.isfinite(found.error).all())
        np.testing.assert_allclose(found.stats.gain, 1, atol=0.02)
        assert found.problems() == ()
    assert traces() == 1


def test_names_and_points_ask_for_no_other_program(monkeypatch):
    given = []

    def caught(read, *_):
        given.append(read)
        raise KeyError

    monkeypatch.setattr(_stereo, "_stereo", caught)
    for names, n in (("abcd", 3), ("efgh", 5)):
        points = np.full((n, 3), [0.0, 0.0, 2.0])
        known = photographs(names=tuple(names), points=points, depth=DEPTHS)
        with pytest.raises(KeyError):
            stereo(known, wanted_of(known), StereoDepth.of(wanted_of(known)))
    one, other = (jax.tree.map(jnp.shape, each) for each in given)
    assert one == other


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_photographs_that_show_nothing_leave_the_whole_range(small, level):
    plain = photographs(np.full(IMAGES.shape, level))
    found = small[0](plain)
    assert bool(jnp.isfinite(found.depth).all())
    low, high = wanted_of(plain).disparity_range
    assert float(found.disparity_error.min()) >= float(high - low)
    assert any("half of the pixels have a standard error" in text for text in found.problems())


def test_exposures_and_dark_corners_do_not_matter(small):
    run, _ = small
    gain = np.array([1.0, 0.8, 1.15, 0.9])
    found = run(photographs((0.8 * gain[:, None, None, None] * IMAGES).clip(0, 1)))
    np.testing.assert_allclose(found.stats.gain, gain, rtol=0.03)
    assert median_error(found) < 0.6
    dark = IMAGES * falloff((0.0, 0.6, 0.3, 0.0), SIZE)
    assert median_error(run(photographs(dark))) < 0.6


@pytest.mark.parametrize("losses", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.4, 0.2, 0.0)])
def test_vignettes_are_measured_along_the_map_and_not_invented(losses):
    size, matrix = (72, 96), np.array([[80.0, 0, 47.5], [0, 80.0, 35.5], [0, 0, 1]])
    images, depths = wall(POSES, matrix=matrix, size=size)
    dark = falloff(losses, size)
    view = Photographs(jnp.asarray((0.1 + 0.7 * images) * dark), POSES, matrix)
    wanted, part = reference_of(view, 0, depth_range=RANGE), Brightness()
    views = PosedViews(wanted.views(view))
    rough, truth = (views.rough_exposure(part), wanted.scale(view) / jnp.asarray(depths[0]))
    found = views.exposure_along(rough.scale, truth, part)
    taken_out = np.log(np.asarray(found.factors(..., size)) * dark[..., 0])
    assert taken_out.std((1, 2)).max() < 0.015
    assert bool(found.uneven) == any(losses)
    assert not bool(rough.uneven)


def test_a_photograph_that_looks_elsewhere_is_ignored(small):
    run, _ = small
    poses, images = POSES.copy(), IMAGES.copy()
    poses[3] = turned(yaw=180.0, at=(0.0, 0.1, 0.0))
    images[3] = np.random.default_rng(0).uniform(size=images[3].shape)
    assert median_error(run(photographs(images, poses))) < 0.6
    # One from the reference's own place has no parallax, and says nothing.
    poses[3], images[3] = POSES[0], IMAGES[0]
    found = run(photographs(images, poses))
    assert bool(jnp.isfinite(found.depth).all())
    assert median_error(found) < 0.6


def test_photographs_of_something_else_are_said_to_fail(small):
    unrelated = [texture(places(POSES[k], DEPTHS[k]), seed=k) for k in range(len(POSES))]
    found = small[0](photographs(np.stack(unrelated)))
    assert float(depth_errors(found.depth, jnp.asarray(DEPTHS[0])).above) > 80
    said = found.problems()
    assert any("of the pixels have no accepted label" in text for text in said)
    assert any("% of their depth" in text for text in said)


@pytest.mark.slow
def test_gradients_with_respect_to_poses_and_images():
    """Of the whole chain: against differences, at the selections made."""
    view, wanted = photographs(), wanted_of(photographs())
    choices = {"refine.solves": 1, "refine.sharpen.mode": "none", "solver.tolerance": 1e-12}
    model = StereoDepth.of(wanted, choices=choices)

    def mean(tree):
        moved = Photographs(tree[0], tree[1], MATRIX)
        return jnp.mean(stereo(moved, wanted, model).depth)

    tree = (view.images * 0.9 + 0.05, view.poses)
    check_gradient(mean, tree, rtol=2e-2, step=1e-7, key=jax.random.key(0))


def test_errors_count_what_is_missing():
    truth = jnp.asarray([[1.0, 2.0, 0.0, 4.0]])
    found = depth_errors(jnp.asarray([[1.0, jnp.inf, 7.0, 4.4]]), truth)
    np.testing.assert_allclose(found.above, 200 / 3)
    # What is not found is off by the median depth, 2.
    np.testing.assert_allclose(found.mse, 100 * (4 + 0.16) / 3, rtol=1e-9)


def test_a_light_field_is_a_set_of_photographs():
    scene = synthetic.scene("slanted")
    field = synthetic.render(scene, shape=(3, 3, 32, 40), samples=1, key=jax.random.key(0))
    views = photographs_of(field)
    assert views.depth is not None
    assert field.truth is not None
    assert views.names[4] == "input_Cam004.png"
    depth = np.asarray(views.depth[4])
    surface = surface_of(views.depth[4], views.poses[4], views.intrinsics[4])
    # Its points, in another view, are where the disparity says.
    for k in (0, 5, 7):
        v, u = divmod(k, 3)
        local = np.asarray(surface.points) - np.asarray(views.poses[k, :3, 3])
        place = local @ np.asarray(views.intrinsics[k]).T
        x, y = place[..., 0] / place[..., 2], place[..., 1] / place[..., 2]
        rows, columns = np.mgrid[:32, :40]
        disparity = np.asarray(field.truth.disparity)
        np.testing.assert_allclose(x, columns + (1 - u) * disparity, atol=2e-3)
        np.testing.assert_allclose(y, rows + (1 - v) * disparity, atol=2e-3)
    # Normals are those of the plane through neighbors, towards the camera.
    normals = np.asarray(surface.normals)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, rtol=1e-5)
    assert (np.sum(normals * np.asarray(surface.points), -1) < 0).mean() > 0.99
    assert depth.min() > 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: photographs(BLACK[:1], np.eye(4)[None]), "at least two"),
        (lambda: photographs(BLACK, POSES[:2] * 2), "`poses` must be rigid"),
        (lambda: Photographs(jnp.asarray(BLACK), POSES[:2], -MATRIX), "`intrinsics` must be .* fx"),
        (lambda: photographs(BLACK, POSES[:3]), r"the shape \(2, 4, 4\), got \(3, 4, 4\)"),
        (lambda: photographs(BLACK * np.nan, POSES[:2]), "`images` must be finite"),
        (lambda: wanted_of(photographs(BLACK, POSES[[0, 0]])), "zero baseline: all cameras are in"),
        (lambda: wanted_of(photographs(), 7), "`index` must be between 0 and 3, got 7"),
        (lambda: wanted_of(photographs(), "x"), "no photograph is called 'x'; there are 0"),
        (lambda: wanted_of(photographs(), 0, (2.0, 1.0)), "`depth_range` must be 0 < near < far"),
        (lambda: wanted_of(photographs(), 0, (1e-320, 1.0)), "begin at .* a millionth of the dist"),
        (
            lambda: wanted_of(photographs(points=np.zeros((1, 3)) - 9), 0, None),
            "have 0 points in the frame of 0, expected at least 2",
        ),
        (
            lambda: StereoDepth.of(wanted_of(photographs(), 0, (0.001, 9.0))),
            "hypotheses, expected at most 768; narrow the range of depths",
        ),
        (lambda: StereoDepth(hypotheses=1), "`hypotheses` must be at least 2, got 1"),
    ],
)
def test_errors_say_what_is_wrong(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "index", "most"),
    [("livingroom5", 0, 25), ("livingroom5", 3, 25), ("livingroom_wide5", 2, 18),
     ("livingroom_wide5", 3, 28), ("livingroom_wide5", 4, 18)],
)  # fmt: skip
def test_a_living_room_from_near_and_far_apart(name, index, most):
    camera = (525.0, 525.0, 319.5, 239.5)
    view = load_photographs(shared_data("mvs", name), intrinsics=camera, scale=0.5)
    assert view.depth is not None
    wanted = reference_of(view, index)
    found = stereo(view.without_truth(), wanted, StereoDepth.of(wanted))
    # On 29 November 23, 23, 16, 26 and 15 %; `livingroom_wide5` had 64 before.
    assert float(depth_errors(found.depth, view.depth[index]).above) < most
    assert found.problems() == ()


@pytest.mark.parametrize(
    ("share", "labeled", "texts"),
    [
        (0.04, 0.38, ()),
        (0.04, 0.18, ("82 % of the pixels have no accepted label",)),
        (0.12, 0.38, ("half of the pixels have a standard error above 12 % of their depth",)),
        (0.12, 0.0, ("100 % of the pixels have no accepted label", "above 12 % of their depth")),
        (np.inf, 0.0, ()),
        (np.nan, 0.0, ()),
    ],
)
def test_labels_and_errors_speak_against_a_map(share, labeled, texts):
    depth = np.full((4, 6), 2.0)
    error = share * depth
    error[0, 0] = np.inf  # a few pixels of no known depth are no problem
    said = depth_problems(depth, error, labeled)
    assert len(said) == len(texts)
    assert all(text in sentence for text, sentence in zip(texts, said, strict=True))
