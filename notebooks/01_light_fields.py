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
# # Light fields, epipolar-plane images, and how to score a depth map
#
# A light field is a grid of photographs taken by cameras side by side. Everything in this package
# starts from one convention about that grid, so this notebook draws it, breaks it, and measures it.

# %%
# %matplotlib inline
import tempfile

import jax
import jax.numpy as jnp
import numpy as np

from mvedge_jax import metrics, plotting
from mvedge_jax.datasets import load_light_field, synthetic, write_hci
from mvedge_jax.metrics.depth import mae, mse
from mvedge_jax.photometry.matching import plane_sweep
from mvedge_jax.warping import backward_warp

# %% [markdown]
# ## Views
#
# `views[v, u, y, x, c]`: `v` counts view rows from the top, `u` view columns from the left. The
# scene is ray-cast, so its disparity is known exactly, in every view.

# %%
light_field = synthetic.render(
    synthetic.scene("demo"), shape=(5, 5, 128, 128), samples=2, key=jax.random.key(0)
)
truth = light_field.truth.disparity
plotting.plot_views(light_field, width=4.5)

# %% [markdown]
# ## Disparity
#
# A point at $(x, y)$ of the center view is at $(x + (u_c - u)\,d,\; y + (v_c - v)\,d)$ in view
# $(v, u)$. Disparity $d$ is in pixels per view step, and **larger is nearer**. `light_field.steps`
# holds $(u_c - u, v_c - v)$, so warping a corner view to the center is one call; with the sign
# turned round the same call makes a mess, which is how a wrong convention shows.

# %%
corner = light_field.views[0, 0]
for sign in (1, -1):
    warped, inside = backward_warp(corner, sign * truth, light_field.steps[0, 0])
    difference = jnp.abs(warped - light_field.center_view).mean(-1)[inside]
    print(f"{sign:+d} x disparity: median error {255 * float(jnp.median(difference)):.2f}/255")

# %% [markdown]
# For data of your own, `mvedge info FOLDER` decides the sign without ground truth: near things must
# cover far ones.
#
# ## Epipolar-plane images
#
# Stack one image row of all views of the center row of the grid, and every scene point draws a
# straight line, $x(u) = x_c + (u_c - u)\,d$: depth has become slope. Where two lines cross, the
# steeper-leaning (nearer) one covers the other. Lines end only there, so a line that is found in
# an epipolar-plane image is an edge that many views agree on.

# %%
row = 80
change = np.abs(np.diff(np.asarray(light_field.center_view)[row].mean(-1)))
columns = np.flatnonzero(change > 0.06)
disparity = np.maximum(np.asarray(truth)[row, columns], np.asarray(truth)[row, columns + 1])
plotting.plot_epi(light_field, row=row, positions=columns + 0.5, disparities=disparity)

# %% [markdown]
# ## A baseline and its errors
#
# A plane sweep tries a set of disparities at every pixel and keeps the one at which the crosshair
# of views agrees best. It is precise where there is texture and noise where there is none, but it
# does not say which is which.

# %%
result = plane_sweep(light_field.without_truth(), planes=48)
scores = metrics.depth_scores(result.disparity, truth)
caption = f"MSE*100 {float(scores.mse):.2f}   BadPix(0.07) {float(scores.bad_07):.1f} %"
plotting.plot_comparison(
    [result.disparity],
    truth,
    names=["plane sweep"],
    captions=[caption],
    image=light_field.center_view,
    width=6.0,
)

# %% [markdown]
# Averages hide what matters in a depth map: its edges. `edge_band` is a mask for any of the
# metrics, and `boundary_scores` asks whether depth jumps where the scene does.

# %%
band = metrics.edge_band(truth)
print(f"MSE*100 near depth edges {float(mse(result.disparity, truth, mask=band)):.2f}")
print(f"        elsewhere        {float(mse(result.disparity, truth, mask=~band)):.2f}")
boundaries = metrics.boundary_scores(result.disparity, truth)
plotting.plot_precision_recall([boundaries], names=["plane sweep"])

# %% [markdown]
# A map with holes never scores better than one without: a disparity that is not finite is as wrong
# as can be, unless a mask leaves it out on purpose.

# %%
holes = result.disparity.at[40:60, 40:60].set(jnp.nan)
print("mean absolute error with holes", mae(holes, truth))
print("the holes masked out          ", mae(holes, truth, mask=jnp.isfinite(holes)))

# %% [markdown]
# ## Files
#
# `load_light_field` recognizes the HCI benchmark, the old HCI archive, Stanford, Lytro and any
# folder of numbered images, and turns all of them into the convention above.

# %%
with tempfile.TemporaryDirectory() as folder:
    write_hci(light_field, folder)
    again = load_light_field(folder)
print(again.views.shape, again.disparity_range)
