"""The thesis' own chain from views to the depth of the centre view."""

from jaxtyping import PRNGKeyArray

from mvedge_jax.lightfield import LightField

from ._sparse_depth import SparseDepth, SparseParams, SparseSizes, sparse_depth
from ._thesis_edges import thesis_edges
from ._thesis_params import ThesisParams, ThesisSizes


def thesis_depth(
    light_field: LightField,
    params: tuple[ThesisParams, SparseParams],
    sizes: tuple[ThesisSizes, SparseSizes],
    *,
    key: PRNGKeyArray | None = None,
) -> SparseDepth:
    """Estimates the centre view's disparity by the thesis' own chain: `edge_to_depth`'s baseline.

    `thesis_edges`, then `sparse_depth`.

    Args:
        light_field: the crosshair of views is read; ground truth is not.
        params: of either.
        sizes: of either.
        key: draws the proposals of the entropy search; only that needs one.

    Returns:
        The map with what it was made from. Differentiable in views and parameters at the lines,
        pixels and sides chosen.

    Raises:
        ValueError: if the entropy search is asked for without a key.

    Source: Thesis 4.1, 4.2.2 and 6.1.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> sizes = (
        ...     ThesisSizes.for_light_field(flat, lines=8),
        ...     SparseSizes.for_light_field(flat),
        ... )
        >>> params = ThesisParams(), SparseParams()
        >>> found = thesis_depth(flat, params, sizes, key=jax.random.key(0))
        >>> found.disparity.shape
        (16, 16)
    """
    points = thesis_edges(light_field, params[0], sizes[0], key=key).points
    return sparse_depth(light_field, points, params[1], sizes[1])
