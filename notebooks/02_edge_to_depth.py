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
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from mvedge_jax import plotting
from mvedge_jax.centre import Parameters, Sizes, edge_to_depth
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.datasets import synthetic
from mvedge_jax.edges.sides import BidirectionalParams, bidirectional
from mvedge_jax.metrics import depth_scores

# %%
light_field = synthetic.render(
    synthetic.scene("edges"), shape=(5, 5, 64, 64), samples=2, key=jax.random.key(0)
)
truth = light_field.truth.disparity
blind = light_field.without_truth()
sizes = Sizes.for_light_field(blind, levels=24, median_radius=4)
result = edge_to_depth(blind, Parameters(), sizes)

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
passes = bidirectional(points, srgb_to_gray(blind.centre_view), BidirectionalParams())
plotting.plot_disparity(
    [truth, passes.forward, passes.backward], names=["truth", "+ normal", "- normal"]
)

# %% [markdown]
# ## Dense depth
#
# Labels weighted by their standard errors, smoothness that ends where a colour step and a depth
# step meet, and a weighted median for the steps that are left blurred.

# %%
plotting.plot_disparity([truth, result.disparity], names=["truth", "estimate"])

# %%
plotting.plot_error(result.disparity, truth)

# %%
scores = depth_scores(result.disparity, truth)
print(f"MSE*100 {float(scores.mse):.3g}, BadPix(0.07) {float(scores.bad_07):.3g} %")

# %% [markdown]
# ## A gradient through the whole chain
#
# Points, hypotheses and sides are chosen; everything computed from the choice is differentiable.
# `jax.grad` reaches every parameter and every pixel of every view. There are twenty parameters:

# %%
print(Parameters())


# %%
def loss(logs):
    found = edge_to_depth(blind, jax.tree.map(jnp.exp, logs), sizes).disparity
    return jnp.mean(jnp.log1p(((found - truth) / 0.03) ** 2))


step = eqx.filter_jit(eqx.filter_value_and_grad(loss))
logs = jax.tree.map(jnp.log, Parameters())
_, gradient = step(logs)
for name, leaf in vars(gradient.centre).items():
    print(f"d loss / d log centre.{name} = {float(leaf):+.2e}")

# %% [markdown]
# ## Forward mode
#
# One number in, a whole map out: `jax.jvp` gives the derivative of every pixel with respect to one
# parameter at the cost of about two maps. Where does more smoothness move the map?


# %%
def at(log_smoothness):
    smoother = eqx.tree_at(lambda p: p.centre.smoothness, Parameters(), jnp.exp(log_smoothness))
    return edge_to_depth(blind, smoother, sizes).disparity


here = jnp.log(Parameters().centre.smoothness)
_, moved = jax.jit(lambda x: jax.jvp(at, (x,), (jnp.ones_like(x),)))(here)
plotting.plot_disparity([moved], names=["d disparity / d log(smoothness)"])

# %% [markdown]
# ## Parameters learned by gradient
#
# A few steps of Adam on the logarithm of every parameter, on this scene alone. A lower loss here
# says nothing about other scenes: `experiments/learn_parameters.py` learns from two and shows what
# happens to two that it has not seen.

# %%
adam = optax.adam(0.05)
state = adam.init(logs)
losses = []
for _ in range(8):
    value, slope = step(logs)
    losses.append(float(value))
    updates, state = adam.update(slope, state, logs)
    logs = optax.apply_updates(logs, updates)
print("loss per step:", " ".join(f"{value:.4f}" for value in losses))
