"""What a result says against itself."""

from typing import Any

import jax.numpy as jnp
import pytest

from mvedge_jax.depth import DepthResult, DepthStats
from mvedge_jax.edges import EdgeStats
from mvedge_jax.photometry.brightness import Exposure


def _result(**changed) -> DepthResult:
    """A result with nothing wrong but what is asked for."""
    unread: Any = None
    counts = {"candidates": 9, "overflow": 0, "consistent": 9, "valid": 9}
    counts |= {name: value for name, value in changed.items() if name in counts}
    stats = DepthStats(
        edges=EdgeStats(**{name: jnp.asarray(value) for name, value in counts.items()}),
        points=jnp.asarray(1),
        sided=jnp.asarray(1),
        iterations=jnp.asarray([1]),
        converged=jnp.asarray(changed.get("converged", True)),
        noise=unread,
        exposure=Exposure(
            jnp.ones(()),
            jnp.ones((3, 3)),
            jnp.zeros((3, 3, 4, 4)).at[2, 1, 1, 0].set(changed.get("vignette", 0.1)),
        ),
        sound=jnp.asarray(changed.get("sound", True)),
        searched=jnp.asarray([-1.0, 1.0]),
    )
    disparity = jnp.full((4, 6), changed.get("disparity", 0.5))
    error = jnp.full((4, 6), changed.get("error", 0.01))
    return DepthResult(disparity, error, disparity, unread, unread, stats)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"converged": False}, "a diffusion stopped before its tolerance"),
        ({"valid": 0}, "no edge was found: the views do not determine the map"),
        ({"overflow": 7}, "7 weak edges found no slot"),
        ({"disparity": jnp.nan}, "24 of 24 disparities are NaN or infinite"),
        ({"disparity": jnp.nan}, "a black view may be why: `datasets.find_dead_views` names it"),
        ({"error": jnp.inf}, "no pixel was measured at all"),
        ({"error": 1.5}, "a standard error above 1.5 px, of a range of 2 px"),
        ({"disparity": -1.2}, "100 % of the pixels lie beyond the lowest disparity"),
        ({"vignette": -0.4}, "brightness of view (2, 1) varies by 40 %"),
        ({"disparity": 1.2}, "beyond the highest disparity that was tried, 1 px"),
        ({"sound": False, "disparity": jnp.nan}, "a parameter is NaN, infinite or negative"),
    ],
)
def test_what_is_wrong_is_said(change, text):
    found = _result(**change)
    assert any(text in sentence for sentence in found.problems())
    with pytest.raises(RuntimeError, match="The depth is not to be trusted: ") as caught:
        found.check()
    assert text in str(caught.value)


def test_a_good_map_says_nothing_nor_do_a_few_pixels_beyond_the_range():
    found = _result()
    assert found.problems() == ()
    assert found.check() is found
    few = found._replace(disparity=jnp.full((10, 10), 0.5).at[0, 0].set(3.0))
    assert few.problems() == ()
