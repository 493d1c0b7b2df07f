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
# # Superpixels of all views
#
# A light field cut into small patches of surface, each with one label in every view: pick a patch
# in one view, and it is picked in all of them. To keep this notebook quick, the depth is the true
# one; `depth_of_views` estimates it.

# %%
# %matplotlib inline
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mvedge_jax import plotting
from mvedge_jax.all_views import ViewDepths
from mvedge_jax.datasets import synthetic
from mvedge_jax.edit import paint
from mvedge_jax.metrics.superpixels import superpixel_scores
from mvedge_jax.superpixels import (
    SuperpixelClustering,
    soft_superpixels,
    superpixels,
    through_superpixels,
)

# %%
light_field = synthetic.render(
    synthetic.scene("edges"), shape=(3, 3, 80, 80), samples=2, key=jax.random.key(0)
)
truth, blind = light_field.truth, light_field.without_truth()
exact = truth.view_disparity
depths = ViewDepths(exact, 0 * exact, jnp.zeros(exact.shape, jnp.int8), jnp.asarray(0))
model = SuperpixelClustering.for_depths(depths, choices={"size": 10.0})
found = superpixels(blind, depths, model)
print(f"{int(found.number)} superpixels, {80 * 80 / 10**2:.0f} aimed at")

# %% [markdown]
# ## The same patches in all views
#
# In the center view and the corner views, outlined and in one color per label.

# %%
plotting.plot_superpixels(blind.views, found.labels)

# %%
colors = plotting.label_colors(int(found.number))
plotting.plot_superpixels(blind.views, found.labels, colors=colors)

# %% [markdown]
# ## What is known of a patch
#
# Place, plane, mean color, area in the center view, what it touches, and the least label of the
# surface that it is part of.

# %%
y, x = 40, 40
label = int(found.labels[1, 1, y, x])
row = label - 1
print(f"label {label}: {int(found.area[row])} px around {np.asarray(found.xy[row]).round(1)}")
print(f"disparity {float(found.plane[row, 0]):.3f} px, slopes {np.asarray(found.plane[row, 1:])}")
pairs = np.asarray(found.neighbors)
touching = pairs[(pairs == label).any(1)]
print(f"touches {sorted(set(touching.ravel()) - {label})}, parent {int(found.parents[row])}")

# %% [markdown]
# ## Scores
#
# Against the true objects, in all views.

# %%
scores = superpixel_scores(found.labels, truth.view_ids, exact)
for name in ("accuracy", "recall", "undersegmentation_once", "compactness", "labels_per_pixel"):
    print(f"{name:24} {float(getattr(scores, name)):.4f}")

# %% [markdown]
# ## One click, all views
#
# The patch under a pixel of the center view, recolored in every view.

# %%
mask = (found.labels[1, 1] == label).astype(blind.views.dtype)
plotting.plot_views(paint(blind, exact, mask, jnp.array([0.9, 0.1, 0.1])))

# %% [markdown]
# ## Shares instead of labels
#
# `soft_superpixels` says how much each pixel belongs to the nine superpixels around it, and has
# gradients in the views and in the disparity. What is lost by describing the picture with one
# color per superpixel, and what would reduce it?


# %%
def loss(disparity):
    soft = soft_superpixels(blind, depths._replace(disparity=disparity), model)
    return jnp.mean((through_superpixels(soft, blind.center_view) - blind.center_view) ** 2)


value, gradient = eqx.filter_jit(jax.value_and_grad(loss))(exact)
print(f"mean squared loss {float(value):.2e}")
plotting.plot_disparity([1e6 * gradient[1, 1]], names=["1e6 d loss / d disparity"])
