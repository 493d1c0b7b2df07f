# ---
# jupyter:
#   jupytext:
#     formats: py:percent,ipynb
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Points that render to depth, and learn from it
#
# Chapter 7 of the thesis turns multi-view edges into a differentiable model: points are splatted
# with occlusion, their labels diffused, and the map is compared with something, a known map or
# the other views. Everything has a gradient, so the points can move, change their label, lose
# weight, and the smoothness can open where depth steps.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from mvedge_jax.lightfield import GroundTruth
from mvedge_jax.model import (
    DepthModel,
    Renderer,
    Start,
    SupervisedFit,
    fit_edges,
    render_model,
)
from mvedge_jax.model.codec import decode, encode
from mvedge_jax.model.optimization import FixedPoints, Growth
from mvedge_jax.splatting import SplatRaster, SplatWidths, splat

# %% [markdown]
# ## A splat
#
# A point carries a label and a data weight. The nearer one, with the larger disparity, hides the
# other: the label map is that of what is in front, and the weight of what is hidden fades.

# %%
xy = jnp.array([[12.0, 12.0], [15.0, 12.0]])
maps = splat(
    xy,
    jnp.array([1.0, 2.0]),
    jnp.ones(2),
    jnp.ones(2, bool),
    SplatWidths(),
    (24, 28),
    SplatRaster(),
)
figure, axes = plt.subplots(1, 3, figsize=(9, 2.5), layout="constrained")
for axis, name in zip(axes, ("label_sum", "label", "weight"), strict=True):
    axis.imshow(getattr(maps, name))
    axis.set_title(name)

# %% [markdown]
# ## Supervised optimization
#
# Noisy points on a disc before a slanted background, and what 40 iterations make of them.

# %%
rng = np.random.default_rng(0)
height, width = 48, 56
y, x = np.mgrid[:height, :width].astype(np.float32)
truth = np.where((x - 28) ** 2 + (y - 22) ** 2 < 15**2, 1.0, 0.01 * x).astype(np.float32)
at = rng.integers(0, [width, height], (260, 2))
label = truth[at[:, 1], at[:, 0]] + 0.1 * rng.normal(size=260).astype(np.float32)
model = DepthModel(
    jnp.asarray(label, jnp.float32),
    jnp.asarray(at, jnp.float32),
    jnp.zeros(260, jnp.float32),
    jnp.zeros((height, width), jnp.float32),
    jnp.ones(260, bool),
)
renderer = Renderer.on_raster(1)  # raster pixels per pixel and axis; the thesis has 2
fit = SupervisedFit()
before = jax.jit(lambda m: render_model(m, renderer).disparity)(model)
start = Start(model, error=jnp.full(260, 0.1, jnp.float32), disparity=before)
known = GroundTruth(jnp.asarray(truth), jnp.ones(truth.shape, bool))
found = fit_edges(known, start, fit, renderer, strategy=FixedPoints())
figure, axes = plt.subplots(1, 4, figsize=(12, 2.6), layout="constrained")
images = {"truth": truth, "before": before, "after": found.disparity, "Q": found.model.roughness}
for axis, (name, image) in zip(axes, images.items(), strict=True):
    axis.imshow(image, **({} if name == "Q" else {"vmin": 0, "vmax": 1}))
    axis.set_title(name)

# %%
plt.semilogy(found.history.loss)
plt.xlabel("iteration")
plt.ylabel("loss")
mse = [float(jnp.mean((m - truth) ** 2)) for m in (before, found.disparity)]
assert mse[1] < 0.3 * mse[0]
print("mean squared error before and after:", *(f"{value:.5f}" for value in mse))

# %% [markdown]
# Q, the roughness, has opened along the disc's outline: the model has found the depth edge.
#
# A gradient moves a point by a few pixels, and none that another one hides. `Growth`, which
# `fit_edges` uses unless told otherwise, moves such points to where the map is wrong, between
# pieces of the optimization. `progress` is called after each.


# %%
def tell(now):
    moved = 0 if now.grown is None else int(now.grown.recycled)
    print(f"{now.iteration:3d} of {now.iterations}: loss {now.loss:.5f}, {moved} points moved")


grown = fit_edges(known, start, fit, renderer, strategy=Growth(rounds=3), progress=tell)
error = float(jnp.mean((grown.disparity - truth) ** 2))
assert error < mse[1]
print(f"mean squared error {error:.5f}")

# %% [markdown]
# `optimize_edges` does the same against the other views of a light field, without a known map:
# from `start_from_depth(light_field, depth(light_field))`.
#
# ## How little is enough?
#
# `encode` goes the other way: a few hundred points and one bit per pixel that reproduce a map.

# %%
for count in (100, 800):
    code = encode(jnp.asarray(truth), count, iterations=0)
    error = jnp.sqrt(jnp.mean((decode(code) - truth) ** 2))
    print(f"{count:4d} points: root mean square error {float(error):.5f}")
