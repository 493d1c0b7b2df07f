"""`EdgeDepth`: from the views of a light field to the depth of its center view, made of parts."""

from collections.abc import Mapping
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
from jaxtyping import PRNGKeyArray

from mvedge_jax._checks import check_finite, checked_jit, expect, sound, with_numbers
from mvedge_jax._params import cast
from mvedge_jax._paths import described, replaced
from mvedge_jax._split_jit import Halves
from mvedge_jax.edges import EdgeDetector, Edges
from mvedge_jax.edges.sides import SideChoice
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Calibration, gather_evidence
from mvedge_jax.photometry.measuring import Measurement
from mvedge_jax.smoothness import Smoothness

from . import _presets
from ._dense import DenseLabels
from ._halves import Front, diffuse_labels, find_labels, found_edges
from ._labels import PointLabels
from ._presets import Preset
from ._refine import Parts, Refine
from ._result import DepthResult

_MAKERS = "`load_light_field` reads one, `LightField(views)` makes one of an array [v, u, y, x, c]"


class EdgeDepth(eqx.Module):
    r"""Depth of the center view from multi-view edges, a chain of parts.

    1. `calibration`: brightness and noise are measured once and removed from the views.
    2. `measurement`: disparity and standard error of every pixel, from the views that show it.
    3. `edges`: filters in epipolar-plane images locate edge points (Thesis 4.1); the measurement
       gives their disparity.
    4. `sides`: the surface that each point's label belongs to (4.2.2), and depth edges (4.3).
    5. `labels`: the points' labels on the pixels of the center view.
    6. `dense`: a label measured at every pixel, or None for the edges alone.
    7. `smoothness`, `solver`, `refine`: labels are diffused (6.1) repeatedly. The smoothness cuts
       edges between surfaces, and sharpening moves depth steps onto color steps. Pixels beside
       depth steps take the surface that covers most of them (`warping.outline`).

    Every part is a pytree: its arrays are traced, so that `jax.grad` and `jax.vmap` reach them,
    and everything else is static. `replace` puts in any part that implements the same protocol.
    `print(model)` lists all numbers with their units.

    Attributes:
        calibration: see `photometry.Calibration`.
        measurement: see `photometry.measuring.Measurement`; None if no part reads one.
        edges: see `edges.EdgeDetector`.
        sides: see `edges.sides.SideChoice`.
        labels: see `PointLabels`.
        dense: see `DenseLabels`; None for the edges alone.
        smoothness: see `smoothness.Smoothness`.
        solver: of the diffusions of map, slopes and errors: one of `mvedge_jax.diffusion` or any
            solver of Lineax for symmetric operators.
        refine: see `Refine`.
        searched: lowest and highest disparity of the scene, px per view step.

    Example:
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> model = EdgeDepth.for_light_field(flat)
        >>> result = model(flat)
        >>> bool(jnp.isfinite(result.disparity).all())
        True
    """

    calibration: Calibration
    measurement: Measurement | None
    edges: EdgeDetector
    sides: SideChoice
    labels: PointLabels
    dense: DenseLabels | None
    smoothness: Smoothness
    solver: lx.AbstractLinearSolver
    refine: Refine
    searched: tuple[float, float] = eqx.field(static=True)

    def __check_init__(self) -> None:
        for name in ("calibration", "edges", "sides", "labels", "smoothness"):
            part = getattr(self, name)
            if not callable(part):
                raise TypeError(f"`{name}` must be a part that can be called, got {part!r:.60}.")

    @staticmethod
    def for_light_field(
        light_field: LightField,
        *,
        preset: Preset = "full",
        views: Literal["crosshair", "all"] = "crosshair",
        choices: Mapping[str, Any] | None = None,
    ) -> "EdgeDepth":
        """Chooses capacities and ranges on the host, from a light field's shape and its range.

        Numbers in px per view step are scaled for fewer than 9x9 views: four times for 3x3.

        Args:
            light_field: its disparity range is measured if it has none.
            preset: `"full"`: edges and dense labels; `"learned"`: the same, with numbers, and a
                network that weighs the dense labels, learned from random scenes; `"edges"`: the
                edges alone, splatted with transmittance; `"thesis"`: the steps of Chapters 4 and 6.
            views: the views to measure labels in, see `Measurement`.
            choices: numbers and static fields to set, by path, such as `{"refine.solves": 1}`.

        Returns:
            The model. Models for light fields of one shape and nearly the same range share a
            compiled program.

        Raises:
            TypeError: `light_field` is none.
            ValueError: the light field has one view only, a name is unknown, or a choice is out of
                range.
        """
        expect("light_field", light_field, LightField, _MAKERS)
        parts = _presets.parts_for(light_field, preset, views)
        model = EdgeDepth(**parts).replace(_presets.learned(preset))
        return model.replace(_presets.for_few_views(model, light_field.farthest)).replace(choices)

    def replace(self, choices: Mapping[str, Any] | None = None, /, **parts: Any) -> "EdgeDepth":
        """The same model with other parts, numbers or static fields.

        Args:
            choices: by path, such as `{"smoothness.color": 0.5, "refine.solves": 1}`.
            **parts: whole parts by name, such as `smoothness=network`.

        Returns:
            The new model; traced values may be traced.

        Raises:
            ValueError: the model has no such path, or a value is out of range.
            TypeError: a part cannot be called.
        """
        return replaced(self, {**(choices or {}), **parts})

    def __call__(self, light_field: LightField, *, key: PRNGKeyArray | None = None) -> DepthResult:
        """Estimates the disparity of every pixel of the center view, see `estimate_depth`.

        Args:
            light_field: the crosshair of views is read, or all of them; ground truth is not.
            key: of parts that draw, such as the entropy search of `ThesisEdges`.

        Returns:
            See `DepthResult`.
        """
        return estimate_depth(light_field, self, key=key)

    def __str__(self) -> str:
        return "\n".join(described(self))


def depth(
    light_field: LightField, *, preset: Preset = "full", key: PRNGKeyArray | None = None
) -> DepthResult:
    """Estimates the disparity of every pixel of a light field's center view.

    Args:
        light_field: ground truth is not read.
        preset: see `EdgeDepth.for_light_field`.
        key: random key; only preset `"thesis"` needs one.

    Returns:
        See `DepthResult`.

    Raises:
        ValueError: the light field has a single view per arm, or its range can't be measured.

    Example:
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> depth(flat).disparity.shape
        (16, 16)
    """
    return EdgeDepth.for_light_field(light_field, preset=preset)(light_field, key=key)


def validate(light_field: Any, model: Any, **options: Any) -> tuple[Any, ...]:
    """Validates a light field and a model."""
    order = "the order is (light_field, model)"
    expect("light_field", light_field, LightField, f"{_MAKERS}, and {order}")
    made = "`EdgeDepth.for_light_field(light_field)` makes one, and " + order
    expect("model", model, EdgeDepth, made)
    if max(light_field.views.shape[:2]) < 3:
        raise ValueError(
            "`light_field` must have at least three views in a row or in a column, got a grid of "
            f"{light_field.views.shape[0]}x{light_field.views.shape[1]}."
        )
    check_finite(light_field.views)
    _presets.check_covers(light_field, model)
    return (light_field.bare(), with_numbers(model)), options


def chain_in_halves(
    light_field: LightField, model: EdgeDepth, *, key: PRNGKeyArray | None = None
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Arguments of `find_labels`, and those of `diffuse_labels` besides its result."""
    refine = model.refine
    parts = model.calibration, model.measurement, model.edges, model.sides, model.labels
    front = Front(*parts, refine.precision, model.searched, model.dense is not None)
    return (light_field, front, key), (Parts(model.dense, model.smoothness, model.solver, refine),)


@checked_jit(validate, Halves(chain_in_halves, find_labels, diffuse_labels))
def estimate_depth(
    light_field: LightField, model: EdgeDepth, *, key: PRNGKeyArray | None = None
) -> DepthResult:
    """Runs the chain: what calling an `EdgeDepth` does.

    Outside of JAX's transforms it is two programs, compiled side by side: up to the labels, and
    their diffusion. Under `jax.grad` outside of others, either is two: value and pullback. They are
    compiled for every shape of a light field and every combination of static fields that they
    read. The first two have some 1300 memory maps (2500 without `compiler_options`).
    The compiler crashes beyond the 65530 maps that Linux allows, so a process that compiles more
    than about 25 chains should call `jax.clear_caches()` now and then.

    Args:
        light_field: the crosshair of views is read, or all of them (`Measurement.views`); ground
            truth is not.
        model: the parts.
        key: of parts that draw.

    Returns:
        Disparity, standard error, points, statistics. Differentiable, forwards and backwards, in
        the views and in every array of `model` at the selections made: points, hypotheses, sides,
        levels of the median. A leaf that only selects is a threshold: its derivative is 0
        (`describe`). In single precision the derivative of a single pixel is lost below 1e-38 and
        NaN above 1e38: scale a loss that is smaller than 1e-10 or larger than 1e20. Rounding
        leaves a relative error of about 2e-4 in derivatives of single parameters, as these are
        sums that cancel.

    Raises:
        ValueError: the light field has a single view per arm; or, outside `jit`, a number of the
            model is not finite or is negative, or the model was made for a narrower range than the
            light field's or for other positions of the views. Under `jit` such numbers give a map
            of NaN, and `stats.sound` is False.
        TypeError: an argument is of another kind, or their order is another.

    Source: Thesis 6.1, 4.2.2 and 4.3; docs/differences.md lists the differences and their reasons.
    """
    first, rest = chain_in_halves(light_field, model, key=key)
    return diffuse_labels(find_labels(*first), *rest)


@checked_jit(validate)
def multiview_edges(
    light_field: LightField, model: EdgeDepth, *, key: PRNGKeyArray | None = None
) -> Edges:
    """Finds edge points with accurate disparities: the first half of the chain.

    Args:
        light_field: only the crosshair of views is read; ground truth is not.
        model: `calibration`, `measurement` and `edges` are run.
        key: of parts that draw.

    Returns:
        Points and statistics. Positions, disparities, confidences and errors are differentiable
        in the views and in every array of the parts, at the selection made.

    Raises:
        ValueError: as `estimate_depth`; under `jit`, bad numbers give disparities of NaN.
        TypeError: an argument is of another kind, or their order is another.

    Source: Thesis 4.1; docs/differences.md lists the differences and their reasons.

    Example:
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> int(multiview_edges(flat, EdgeDepth.for_light_field(flat)).stats.valid)
        0
    """
    model = cast(model, light_field.views.dtype)
    evidence = gather_evidence(light_field, model.calibration, model.measurement, model.searched)
    edges = found_edges(model.edges, evidence, key)
    read = model.calibration, model.measurement, model.edges
    fine = jnp.all(jnp.stack([sound(part) for part in read if part is not None]))
    # `where` hides NaN parameters, so NaN is propagated explicitly.
    disparity = edges.points.disparity
    disparity = jnp.where(fine, disparity, jnp.asarray(jnp.nan, disparity.dtype))
    return eqx.tree_at(lambda found: found.points.disparity, edges, disparity)
