"""Strict numerics for every test: float64, no silent promotion, warnings are errors."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import matplotlib as mpl
import pytest

_EMITTERS = "--xla_cpu_use_fusion_emitters=false"

mpl.use("Agg")
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")


def pytest_configure(config):
    # Tests neither read what the user has compiled nor leave anything there.
    os.environ["MVEDGE_CACHE"] = "off"
    if config.getoption("markexpr") == "not slow":
        # Compiling is nearly all of the fast tier's time, and unoptimised programs compile faster;
        # so they do by the emitters of fusions that the package's own programs are made with.
        jax.config.update("jax_disable_most_optimizations", True)
        if not hasattr(config, "workerinput"):  # workers are told by the environment
            _ask_for(_EMITTERS)
    # Only our own warnings are errors at collection time; the filter below applies to each test.
    config.addinivalue_line("filterwarnings", "error")
    config.addinivalue_line("filterwarnings", "ignore::DeprecationWarning:tyro")
    warnings.simplefilter("default")


def _ask_for(flag: str) -> None:
    """Has XLA started with a flag, if it knows the flag: it ends a process that asks for others."""
    asked = {"XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {flag}".strip()}
    start = [sys.executable, "-c", "import jax; jax.devices()"]
    started = subprocess.run(start, env=os.environ | asked, capture_output=True, check=False)
    if started.returncode == 0:
        os.environ.update(asked)


def _memory_maps() -> int:
    """How many memory maps this process has; 0 where the system does not say."""
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return 0


@pytest.fixture(autouse=True)
def _forget_programs(request):
    """Drops compiled programs after a slow test, and when there are many.

    Those of the whole chain take thousands of memory maps each, and the compiler crashes when the
    system's limit on maps, 65530 as a rule, is reached.
    """
    yield
    if request.node.get_closest_marker("slow") or _memory_maps() > 15000:
        jax.clear_caches()
