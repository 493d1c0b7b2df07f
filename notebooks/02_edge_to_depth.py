# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # From edges to depth
#
# The method in four pictures: edge points with precise disparities, the side of each edge that they
# belong to, diffusion into a dense map, and a gradient through all of it.

# %%
# %matplotlib inline
import jax
import jax.numpy as jnp
import numpy as np
import optax

import mvedge_jax as mv
from mvedge_jax import plotting
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.datasets import synthetic
from mvedge_jax.edges.sides import DirectionalDiffusion, bidirectional
from mvedge_jax.metrics import depth_scores

# %%
light_field = synthetic.render(
    synthetic.scene("edges"), shape=(5, 5, 64, 64), samples=2, key=jax.random.key(0)
)
truth = light_field.truth.disparity
blind = light_field.without_truth()
small = {"refine.sharpen.levels": 24, "refine.sharpen.radius": 4}  # for a small image
model = mv.EdgeDepth.for_light_field(blind, choices=small)

# %% [markdown]
# A result, and a loss with it: the program is compiled together with its gradient, which the end of
# this page needs. `model(blind)` is all that the first half asks for. The model is made of parts;
# its numbers have paths, by which `model.replace` sets them.


# %%
def loss(logs):
    result = model.replace({path: jnp.exp(log) for path, log in logs.items()})(blind)
    return jnp.mean(jnp.log1p(((result.disparity - truth) / 0.03) ** 2)), result


step = mv.lean_jit(jax.value_and_grad(loss, has_aux=True))
numbers = {row.path: row.value for row in mv.describe(model)}
diffusion = (
    "smoothness.color",
    "smoothness.depth",
    "labels.weight",
    "dense.trust",
    "refine.precision",
    "refine.stiffness",
    "refine.slopes.stiffness",
    "refine.sharpen.epsilon",
    "refine.sharpen.slack",
)
logs = {path: jnp.log(numbers[path]) for path in diffusion}
(_, result), gradient = step(logs)

# %% [markdown]
# ## Points
#
# Every point has a position, a disparity with a standard error, and the direction of the image
# gradient. Where the image has an edge, the views tell the disparity; elsewhere they say little.

# %%
points = result.points
keep = np.asarray(points.valid)
error = np.median(np.asarray(points.error)[keep])
print(f"{keep.sum()} points, median standard error {error:.4f} px")

# %% [markdown]
# ## Surface vectors
#
# An edge in the image is often the border of a near surface, and its disparity belongs to that
# surface only. Pushing all labels to one side of their edges, then to the other, and diffusing each
# time gives two maps. Where the label was pushed onto its own surface, the step stays clean.

# %%
passes = bidirectional(points, srgb_to_gray(blind.center_view), DirectionalDiffusion())
plotting.plot_disparity(
    [truth, passes.forward, passes.backward], names=["truth", "+ normal", "- normal"]
)

# %% [markdown]
# ## Dense depth
#
# Labels weighted by their standard errors, smoothness that ends where a color step and a depth
# step meet, and a weighted median for the steps that are left blurred.

# %%
plotting.plot_disparity([truth, result.disparity], names=["truth", "estimate"])

# %%
plotting.plot_error(result.disparity, truth)

# %%
scores = depth_scores(result.disparity, truth)
print(f"MSE*100 {float(scores.mse):.3g}, BadPix(0.07) {float(scores.bad_07):.3g} %")

# %% [markdown]
# ## The edges alone
#
# This map has a label at every pixel, measured in the views. The preset `"edges"` has none of
# these: the labels of the edge points are splatted, nearest first, and diffused.

# %%
of_edges = mv.EdgeDepth.for_light_field(blind, preset="edges", choices=small)(blind)
plotting.plot_disparity(
    [truth, result.disparity, of_edges.disparity], names=["truth", "full", "edges"]
)

# %% [markdown]
# ## A gradient through the chain
#
# Points, hypotheses and sides are chosen; everything computed from the choice is differentiable.
# `jax.grad` reaches every number and every pixel of the views that are read: by default those of
# the center row and column, with `views="all"` all of them. In views that are not read, it is
# exactly 0. These are the numbers, by part:

# %%
print(model)

# %% [markdown]
# These are the derivatives in nine of the diffusion. In all of them and in the views, the program
# takes longer to compile: `eqx.filter_grad` of a function of the model. Forward mode, one number in
# and a map out, is in notebook 05.

# %%
for path, slope in gradient.items():
    print(f"d loss / d log {path} = {float(slope):+.2e}")

# %% [markdown]
# ## Numbers learned by gradient
#
# A few steps of Adam on the logarithms of these, on this scene alone. A lower loss here
# says nothing about other scenes: `experiments/learn_parameters.py` learns from two and shows what
# happens to two that it has not seen.

# %%
adam = optax.adam(0.05)
state = adam.init(logs)
losses = []
for _ in range(8):
    (value, _), slope = step(logs)
    losses.append(float(value))
    updates, state = adam.update(slope, state, logs)
    logs = optax.apply_updates(logs, updates)
print("loss per step:", " ".join(f"{value:.4f}" for value in losses))
