"""The transpose of the volume of costs, part by part, against that of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import lean

from mvedge_jax.photometry.matching import _volume
from mvedge_jax.photometry.matching._arm import Half, Limits, Swept
from mvedge_jax.photometry.matching._volume import Sweep, volume

_RNG = np.random.default_rng(0)


def _uniform(*shape):
    return _RNG.uniform(size=shape)


def _arm(height, width, *, window, counts):
    def half(sign, count):
        padding = ((0, 0), (0, 0), (0, 0), (width, width + 3))
        planes = np.pad(_uniform(count, 3, height, width), padding, mode="edge")
        steps = sign * jnp.asarray([1.5, 4.0])[:count]
        return Half(jnp.asarray(planes), steps, jnp.ones(count))

    def weights():
        found = _uniform((2 * window + 1) ** 2, height, width)
        return jnp.asarray(found / found.sum(0))

    share = jnp.asarray(_uniform(height, width))
    halves = half(-1, counts[0]), half(1, counts[1])
    return Swept(jnp.asarray(_uniform(3, height, width)), halves, weights(), weights(), share)


def _sweep(shape, *, window, counts=(2, 2), alpha=0.3):
    limits = Limits(jnp.asarray(0.05), jnp.asarray(0.02), jnp.asarray(alpha))
    across = _arm(*shape, window=window, counts=counts)
    down = _arm(*shape[::-1], window=window, counts=counts)
    return Sweep(across, down, jnp.linspace(-2, 2.1, 5), limits)


def _cotangent(shape, share):
    """Of few pixels, of no pixel of one hypothesis, and of the corners."""
    found = _RNG.normal(size=(5, *shape)) * (_RNG.uniform(size=(5, *shape)) < share)
    found[1] = 0
    found[3, 0, 0], found[2, -1, -1] = 1, 2
    return jnp.asarray(found)


def _alike(found, expected):
    for (path, a), b in zip(
        jax.tree_util.tree_leaves_with_path(found), jax.tree.leaves(expected), strict=True
    ):
        close = 1e-11 * (1 + np.abs(b).max(initial=0))
        np.testing.assert_allclose(a, b, atol=close, err_msg=jax.tree_util.keystr(path))


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch):
    monkeypatch.setattr(_volume, "_PART", 16)


# No multiple of the side of a part, less than one, and a half without views.
@pytest.mark.parametrize(
    ("shape", "share", "window", "counts", "alpha"),
    [
        ((37, 41), 0.003, 1, (2, 2), 0.3),
        ((12, 30), 1.0, 1, (1, 1), 0.3),
        ((20, 24), 0.1, 0, (2, 0), 0.0),
    ],
)
def test_the_transpose_is_that_of_the_costs(shape, share, window, counts, alpha):
    sweep = _sweep(shape, window=window, counts=counts, alpha=alpha)
    value, own = jax.vjp(lambda s: volume(window, s), sweep)
    plain, expected = jax.vjp(_volume._costs, sweep)
    np.testing.assert_array_equal(value, plain)
    cotangent = _cotangent(shape, share)
    _alike(lean(own)(cotangent)[0], lean(expected)(cotangent)[0])


@pytest.mark.slow
def test_forward_mode_and_forward_over_reverse_are_those_of_the_costs():
    """A tangent of the cotangent where there is none: what is left out must not be forgotten."""
    shape = (20, 24)
    sweep, cotangent = _sweep(shape, window=0, counts=(1, 1)), _cotangent(shape, 0.02)
    tangent = jax.tree.map(lambda a: jnp.asarray(_RNG.normal(size=a.shape)), sweep)
    turned = jnp.asarray(_RNG.normal(size=cotangent.shape))

    def results(costs):
        def pulled(sweep, cotangent):
            return jax.vjp(costs, sweep)[1](cotangent)[0]

        along = jax.jvp(costs, (sweep,), (tangent,))[1]
        return along, jax.jvp(pulled, (sweep, cotangent), (tangent, turned))[1]

    own = lean(lambda: results(lambda s: volume(0, s)))()
    _alike(own, lean(lambda: results(_volume._costs))())


def test_a_batch_is_a_loop():
    shape = (20, 24)
    sweep = _sweep(shape, window=0, counts=(1, 1))
    cotangents = jnp.stack([_cotangent(shape, 0.02), jnp.zeros((5, *shape))])
    pull = jax.vjp(lambda s: volume(0, s), sweep)[1]
    found, alone = lean(jax.vmap(lambda ct: pull(ct)[0]))(cotangents), lean(pull)
    for i, cotangent in enumerate(cotangents):
        _alike(jax.tree.map(lambda a, i=i: a[i], found), alone(cotangent)[0])
