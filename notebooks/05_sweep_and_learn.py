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
# # A sweep, a learned number, a learned part
#
# Every number of an `EdgeDepth` is traced: settings run in batches through one program, and have
# derivatives. Two ways to choose one, and a network in place of a part, on rows of views so small
# that this page runs in a minute or two, most of which the compiler takes: what is found here is
# not what larger scenes want.

# %%
# %matplotlib inline
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optax
import optuna

import mvedge_jax
from mvedge_jax import plotting
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField
from mvedge_jax.smoothness import ColorAndDepth
from mvedge_jax.sweep import Interval, Space, plot_sweep, sweep

mvedge_jax.compilation_cache()
optuna.logging.set_verbosity(optuna.logging.WARNING)
plt.rcParams["figure.dpi"] = 60


# %% [markdown]
# ## Scenes
#
# Two to choose by, one that only judges. One range for all, so that one program serves them.


# %%
def small(name):
    field = synthetic.render(
        synthetic.scene(name), shape=(1, 5, 48, 48), samples=2, key=jax.random.key(0)
    )
    return LightField(field.views, disparity_range=(-2.0, 2.0), truth=field.truth)


chosen_by = {name: small(name) for name in ("edges", "demo")}
judge = small("slanted")
choices = {"refine.solves": 1, "refine.sharpen.levels": 8}
model = EdgeDepth.for_light_field(judge, choices=choices)


# %% [markdown]
# ## A sweep
#
# The objective may be any function of the result that `jax.jit` takes; here it is smooth, so that
# it can be learned from below, too. Settings are asked of Optuna; four at a time are one call.


# %%
def loss(disparity, light_field):
    error = disparity - light_field.truth.disparity
    return jnp.mean(jnp.log1p((error / 0.03) ** 2))


space = Space({"smoothness.depth": Interval(0.01, 0.5), "refine.precision": Interval(0.001, 0.05)})
found = sweep(
    list(chosen_by.values()),
    space,
    start=choices,
    trials=32,
    batch=4,
    objective=lambda result, light_field: loss(result.disparity, light_field),
)
print(f"defaults {found.rows[0]['mean']:.4f}, best {found.value:.4f}: {found.study.best_params}")
plot_sweep(found)


# %% [markdown]
# ## A learned number
#
# The derivative in one number is a pass forwards beside the value: `jax.jvp`, here of the loss and
# of the map at once. (All numbers at once: `jax.grad`, see notebook 02 and the page on gradients.)


# %%
def with_depth(model, log):
    return model.replace({"smoothness.depth": jnp.exp(log)})


@mvedge_jax.lean_jit
def value_and_slope(model, light_field):
    """Loss and map; the derivatives of both in the logarithm of `smoothness.depth`."""

    def of(log):
        found = with_depth(model, log)(light_field)
        return loss(found.disparity, light_field), found.disparity

    log = jnp.log(model.smoothness.depth)
    return jax.jvp(of, (log,), (jnp.ones_like(log),))


# %% [markdown]
# Where would the map move if smoothness ended at larger steps of depth only?

# %%
demo = chosen_by["demo"]
(_, disparity), (_, moved) = value_and_slope(model, demo)
plotting.plot_disparity([demo.truth.disparity, disparity], names=["truth", "estimate"])

# %%
plotting.plot_disparity([moved], names=["d disparity / d log(smoothness.depth)"])

# %% [markdown]
# Adam steps along the logarithm.

# %%
log = jnp.log(model.smoothness.depth)
adam = optax.adam(0.2)
state, path = adam.init(log), []
for _ in range(16):
    moved = with_depth(model, log)
    pairs = [value_and_slope(moved, field) for field in chosen_by.values()]
    value, slope = (sum(x for x, _ in part) / len(pairs) for part in zip(*pairs, strict=True))
    path.append((float(jnp.exp(log)), float(value)))
    step, state = adam.update(slope, state)
    log = optax.apply_updates(log, step)
path = np.array(path)
learned = model.replace({"smoothness.depth": path[path[:, 1].argmin(), 0]})

fig, ax = plt.subplots(figsize=(5, 3))
tried = [row for row in found.rows if row["mean"] is not None]
ax.semilogx(
    [row["smoothness.depth"] for row in tried],
    [row["mean"] for row in tried],
    ".",
    color="0.6",
    label="sweep (two numbers)",
)
ax.semilogx(*path.T, "o-", markersize=3, label="Adam (one number)")
ax.set(xlabel="smoothness.depth, px", ylabel="mean loss")
ax.legend()

# %% [markdown]
# ## A scene that was not chosen by
#
# A lower loss on two scenes says nothing about a third, so look.

# %%
swept = model.replace(found.choices)
for name, chosen in (("defaults", model), ("sweep", swept), ("learned", learned)):
    scores = [float(value_and_slope(chosen, field)[0][0]) for field in (*chosen_by.values(), judge)]
    print(f"{name:9} chosen by {np.mean(scores[:2]):.4f}   unseen {scores[2]:.4f}")


# %% [markdown]
# ## A part of one's own
#
# A smoothness is any `equinox.Module` that is called with the center view, the map of the previous
# diffusion and the depth-edge confidence, and returns weights of the edges between neighboring
# pixels.
# This one scales those of the default by what a convolution sees. It is trained through the chain
# of preset `"edges"`, in which the labels of edge points are all there is.


# %%
class Corrected(eqx.Module):
    network: eqx.nn.Conv2d

    def __init__(self, key):
        network = eqx.nn.Conv2d(4, 2, 3, padding=1, key=key)
        self.network = jax.tree.map(jnp.zeros_like, network)  # the default itself at first

    def __call__(self, guide, disparity, depth_edge):
        tx, ty = ColorAndDepth()(guide, disparity, depth_edge)
        right, down = jnp.exp(self.network(jnp.concatenate([guide / 50, disparity[None]])))
        return jnp.minimum(tx * right[:, :-1], 1), jnp.minimum(ty * down[:-1], 1)


small_image = {"refine.sharpen.levels": 8}
edges = EdgeDepth.for_light_field(judge, preset="edges", choices=small_image)


@mvedge_jax.lean_jit
@eqx.filter_value_and_grad
def network_loss(smoothness, light_field):
    found = edges.replace(smoothness=smoothness)(light_field)
    return loss(found.disparity, light_field)


smoothness = Corrected(jax.random.key(0))
adam = optax.adam(0.03)
state = adam.init(smoothness)
for number in range(21):
    pairs = [network_loss(smoothness, field) for field in chosen_by.values()]
    value = np.mean([value for value, _ in pairs])
    if number in (0, 20):
        unseen = float(network_loss(smoothness, judge)[0])
        print(f"after {number:2d} steps: learned from {value:.4f}   unseen {unseen:.4f}")
    slope = jax.tree.map(lambda *parts: sum(parts) / len(parts), *(slope for _, slope in pairs))
    step, state = adam.update(slope, state)
    smoothness = optax.apply_updates(smoothness, step)
