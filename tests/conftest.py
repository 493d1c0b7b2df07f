"""Strict numerics for every test, programs that workers share, and what a run has cost."""

import itertools
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import textwrap
import time
import warnings
from collections import Counter
from pathlib import Path

import jax
import matplotlib as mpl
import pytest

_EMITTERS = "--xla_cpu_use_fusion_emitters=false"
_PROGRAMS = pytest.StashKey[str]()
# Other files, which start at the same time where these come in order, compile their programs.
_LAST = ("tests/cli/test_superpixels.py",)

mpl.use("Agg")
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")


def pytest_configure(config):
    # Tests neither read what the user has compiled nor leave anything there.
    os.environ["MVEDGE_CACHE"] = "off"
    if config.getoption("markexpr") == "not slow":
        # Compiling is nearly all of the fast tier's time, and unoptimized programs compile faster;
        # so they do by the emitters of fusions that the package's own programs are made with.
        jax.config.update("jax_disable_most_optimizations", True)
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # of the processes that tests start
        if not hasattr(config, "workerinput"):  # workers are told by the environment
            _ask_for(_EMITTERS)
    if not hasattr(config, "workerinput"):
        config.stash[_PROGRAMS] = tempfile.mkdtemp(prefix="mvedge_tests_")
        _share_programs(config.stash[_PROGRAMS])
    # Only our own warnings are errors at collection time; the filter below applies to each test.
    config.addinivalue_line("filterwarnings", "error")
    config.addinivalue_line("filterwarnings", "ignore::DeprecationWarning:tyro")
    # What another worker is writing just now is compiled as usual.
    config.addinivalue_line("filterwarnings", "ignore:Error reading persistent compilation cache")
    warnings.simplefilter("default")


def pytest_unconfigure(config):
    if _PROGRAMS in config.stash:
        shutil.rmtree(config.stash[_PROGRAMS], ignore_errors=True)


def _share_programs(folder: str) -> None:
    """Has this run's processes, and no other, read from a folder what one of them has compiled."""
    settings = {
        "jax_compilation_cache_dir": folder,
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    for name, value in settings.items():
        jax.config.update(name, value)
        os.environ[name.upper()] = str(value)


@pytest.fixture(scope="module")
def optimized():
    """Programs as users have them, where tests wait for them rather than for the compiler."""
    name = "jax_disable_most_optimizations"
    before = jax.config.read(name)
    jax.config.update(name, False)
    yield
    jax.config.update(name, before)


_spent = [0.0]


def _cpu_seconds() -> float:
    """CPU time of this process and of the children that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: item.nodeid.startswith(_LAST))


def pytest_collection_finish():
    _spent[0] = _cpu_seconds()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    report = yield
    before, _spent[0] = _spent[0], _cpu_seconds()
    report.cpu = _spent[0] - before
    return report


def pytest_terminal_summary(terminalreporter):
    """CPU seconds by folder, which a busy machine changes less than it does the clock's."""
    by_folder: Counter[str] = Counter()
    for report in itertools.chain(*terminalreporter.stats.values()):
        if not hasattr(report, "cpu"):
            continue  # a warning
        folders = report.nodeid.partition("::")[0].split("/")[:-1]
        by_folder["/".join(folders[:2])] += report.cpu
    if not by_folder:
        return
    terminalreporter.section(f"CPU seconds: {sum(by_folder.values()):.0f}")
    shares = (f"{folder} {seconds:.0f}" for folder, seconds in by_folder.most_common(24))
    terminalreporter.write_line(textwrap.fill(", ".join(shares), 100))


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
