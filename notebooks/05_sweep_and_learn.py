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
# # A sweep and a learned parameter
#
# Every number of `Parameters` is traced: settings run in batches through one program, and have
# derivatives. Two ways to choose one, on rows of views so small that this page runs in a minute,
# most of which the compiler takes: what is found here is not what larger scenes want.

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
from mvedge_jax.depth import Parameters, Sizes, edge_to_depth
from mvedge_jax.lightfield import LightField
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
choices = {"solves": 1, "levels": 8}
sizes = Sizes.for_light_field(judge.without_truth(), **choices)


# %% [markdown]
# ## A sweep
#
# The objective may be any function of the result that `jax.jit` takes; here it is smooth, so that
# it can be learned from below, too. Settings are asked of Optuna; four at a time are one call.


# %%
def loss(disparity, light_field):
    error = disparity - light_field.truth.disparity
    return jnp.mean(jnp.log1p((error / 0.03) ** 2))


space = Space(
    {"smoothness.depth": Interval(0.01, 0.5), "centre.precision": Interval(0.001, 0.05)},
    {name: (value,) for name, value in choices.items()},
)
found = sweep(
    list(chosen_by.values()),
    space,
    trials=32,
    batch=4,
    objective=lambda result, light_field: loss(result.disparity, light_field),
)
print(f"defaults {found.rows[0]['mean']:.4f}, best {found.value:.4f}: {found.study.best_params}")
plot_sweep(found)


# %% [markdown]
# ## A learned parameter
#
# The derivative in one number is a pass forwards beside the value: `jax.jvp`, here of the loss and
# of the map at once. (All numbers at once: `jax.grad`, see notebook 02 and the page on gradients.)


# %%
def with_depth(params, log):
    return eqx.tree_at(lambda p: p.smoothness.depth, params, jnp.exp(log))


@mvedge_jax.lean_jit
def value_and_slope(params, light_field):
    """Loss and map; the derivatives of both in the logarithm of `smoothness.depth`."""

    def of(log):
        found = edge_to_depth(light_field.without_truth(), with_depth(params, log), sizes)
        return loss(found.disparity, light_field), found.disparity

    log = jnp.log(params.smoothness.depth)
    return jax.jvp(of, (log,), (jnp.ones_like(log),))


# %% [markdown]
# Where would the map move if smoothness ended at larger steps of depth only?

# %%
demo = chosen_by["demo"]
(_, disparity), (_, moved) = value_and_slope(Parameters(), demo)
plotting.plot_disparity([demo.truth.disparity, disparity], names=["truth", "estimate"])

# %%
plotting.plot_disparity([moved], names=["d disparity / d log(smoothness.depth)"])

# %% [markdown]
# Adam steps along the logarithm.

# %%
log = jnp.log(Parameters().smoothness.depth)
adam = optax.adam(0.2)
state, path = adam.init(log), []
for _ in range(16):
    params = with_depth(Parameters(), log)
    pairs = [value_and_slope(params, field) for field in chosen_by.values()]
    value, slope = (sum(x for x, _ in part) / len(pairs) for part in zip(*pairs, strict=True))
    path.append((float(jnp.exp(log)), float(value)))
    step, state = adam.update(slope, state)
    log = optax.apply_updates(log, step)
path = np.array(path)
learned = with_depth(Parameters(), jnp.log(jnp.asarray(path[path[:, 1].argmin(), 0], jnp.float32)))

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
for name, params in (("defaults", Parameters()), ("sweep", found.params), ("learned", learned)):
    scores = [float(value_and_slope(params, field)[0][0]) for field in (*chosen_by.values(), judge)]
    print(f"{name:9} chosen by {np.mean(scores[:2]):.4f}   unseen {scores[2]:.4f}")
