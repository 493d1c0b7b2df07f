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
# # Depth of every view, and edits that occlude
#
# A map of the center view says nothing of what the center view does not show. Edits need it: a
# thing that is put into the scene has to be hidden by what is in front of it in every view, and
# what is taken away leaves behind what only other views have seen.

# %%
# %matplotlib inline
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from mvedge_jax import plotting
from mvedge_jax.all_views import ViewDepth, depth_of_views
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import depth
from mvedge_jax.edit import insert_picture, paint, remove
from mvedge_jax.metrics import view_consistency
from mvedge_jax.metrics.depth import bad_pixels, mse
from mvedge_jax.warping import forward_warp, holes

# %%
light_field = synthetic.render(
    synthetic.scene("edges"), shape=(5, 5, 128, 128), samples=2, key=jax.random.key(0)
)
truth = light_field.truth.view_disparity
blind = light_field.without_truth()
result = depth(blind)
found = depth_of_views(blind, result, ViewDepth.for_light_field(blind))


def moved(step):
    """The center view's map in another view; holes go on with the surface behind."""
    warped = forward_warp(result.disparity[..., None], result.disparity, step)
    return warped.disparity.ravel()[holes(warped.disparity, warped.hit).behind]


naive = jax.vmap(jax.vmap(moved))(blind.steps)

# %% [markdown]
# ## What the center view does not show
#
# The pixels of the center view are moved to every view. What is left open is measured in the
# corner views, and shared: every pixel of every map is one of a common set of samples. `source`
# says which: 0, seen by the center view; 1, by other views only; 2, by none, and continued from
# the surface behind.

# %%
corner = (0, 0)
figure, axes = plt.subplots(1, 4, figsize=(13, 3.2), layout="constrained")
pictures = {
    "view (0, 0)": light_field.views[corner],
    "known from": found.source[corner],
    "moved: error, px": jnp.abs(naive - truth)[corner],
    "ours: error, px": jnp.abs(found.disparity - truth)[corner],
}
for axis, (name, picture) in zip(axes, pictures.items(), strict=True):
    limit = {"vmin": 0, "vmax": 0.3} if "error" in name else {}
    axis.imshow(np.asarray(picture), **limit)
    axis.set(title=name, xticks=[], yticks=[])

# %%
for name, maps in (("moved", naive), ("ours", found.disparity)):
    pairs = [(maps[at], truth[at]) for at in np.ndindex(5, 5)]
    errors = np.mean([mse(*pair) for pair in pairs])
    wrong = np.mean([bad_pixels(*pair, 0.07) for pair in pairs])
    print(
        f"{name}: mean over the views, MSE*100 {errors:.2f}, off by more than .07 px {wrong:.2f} %"
    )

# %% [markdown]
# ## All maps
#
# What is gained is gained at the edges and behind them; where the center view's map is off by a
# little, as on the wall of so small a scene, all maps are.
#
# How much the maps of the views disagree about the same point is a score that knows no truth, and
# a constant map would win it: read it beside the errors.

# %%
plotting.plot_view_maps(found.disparity)

# %%
scores = [view_consistency(maps) for maps in (found.disparity, naive)]
plotting.plot_consistency(scores, names=["ours", "moved"])

# %% [markdown]
# ## Something between
#
# A striped card between the red dots and the golden diamond covers the one and is covered by the
# other. Pixels of the views that it does not cover keep their bits.

# %%
stripes = (np.arange(72) // 6) % 2
card = np.zeros((30, 72, 4), np.float32)
card[..., 3] = 1
card[..., 1] = np.where(stripes[None], 0.9, 0.45)
card[..., 2] = 0.6
edited = insert_picture(blind, found.disparity, jnp.asarray(card), at=(66.0, 62.0), disparity=0.25)
plotting.plot_views(edited)

# %% [markdown]
# ## Paint, and something gone
#
# Paint on a surface of the center view follows it into all views, and goes on where the center
# view does not show it. What is removed leaves what other views saw behind it; `radius` takes along
# the pixels around it that blend with it.

# %%
columns, rows = jnp.meshgrid(jnp.arange(128), jnp.arange(128))
ball = (result.disparity > 1.1) & (jnp.hypot(columns - 64.0, rows - 106.0) < 13)
painted = paint(blind, found.disparity, ball.astype(jnp.float32), jnp.asarray([0.9, 0.3, 0.6]))
gone = remove(blind, found.disparity, ball, radius=2)
figure, axes = plt.subplots(2, 3, figsize=(9, 6), layout="constrained")
for row, at in zip(axes, ((0, 0), (4, 4)), strict=True):
    for axis, name, field in zip(
        row, ("as it was", "painted", "removed"), (blind, painted, gone), strict=True
    ):
        axis.imshow(np.asarray(field.views[at]))
        axis.set(title=f"{name}, view {at}", xticks=[], yticks=[])
