"""Strict numerics for every test: float64, no silent promotion, warnings are errors."""

import warnings

import jax
import matplotlib as mpl
import pytest

mpl.use("Agg")
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")


def pytest_configure(config):
    if config.getoption("markexpr") == "not slow":
        # Compiling is nearly all of the fast tier's time, and unoptimised programs compile faster.
        jax.config.update("jax_disable_most_optimizations", True)
    # Only our own warnings are errors at collection time; the filter below applies to each test.
    config.addinivalue_line("filterwarnings", "error")
    config.addinivalue_line("filterwarnings", "ignore::DeprecationWarning:tyro")
    warnings.simplefilter("default")


@pytest.fixture(autouse=True)
def _forget_large_programs(request):
    """Drops compiled programs after a slow test.

    Those of the whole chain take thousands of memory maps each, and the compiler crashes when the
    system's limit on maps is reached.
    """
    yield
    if request.node.get_closest_marker("slow"):
        jax.clear_caches()
