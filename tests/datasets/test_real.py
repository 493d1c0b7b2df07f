"""A scene of the benchmark: its camera is right, and loading it costs little."""

import subprocess
import sys

import cv2
import numpy as np
import pytest
from datasets.layouts import known
from helpers import shared_data

from mvedge_jax.datasets import load_light_field, read_pfm

pytestmark = pytest.mark.slow


def test_cotton():
    folder = shared_data("hci", "cotton")
    light_field = load_light_field(folder)
    low, high = np.asarray(light_field.disparity_range)
    disparity = known(light_field.truth).disparity
    assert low < float(disparity.min()) < float(disparity.max()) < high
    # The camera gives the benchmark's own depth map, but at depth edges that it samples elsewhere.
    depth = np.asarray(known(light_field.camera).depth(disparity))
    error = np.abs(depth - read_pfm(folder / "gt_depth_lowres.pfm"))
    assert np.median(error) < 1e-4
    assert np.percentile(error, 99) < 1e-3
    assert set(np.unique(np.asarray(known(light_field.truth).object_ids))) == {1, 4}


def test_cotton_within_time_and_memory():
    """81 views of 512x512 in under 4 s and 600 MB, the interpreter with JAX included.

    On a busy machine the processor's time stands for the clock's; on a quiet one it is the longer.
    """
    code = f"""
import re, time
from pathlib import Path
from mvedge_jax.datasets import load_light_field
start = time.perf_counter(), time.process_time()
load_light_field({str(shared_data("hci", "cotton"))!r}).views.block_until_ready()
elapsed = min(time.perf_counter() - start[0], time.process_time() - start[1])
# Not `ru_maxrss`, which begins at the size of the process that started this one.
peak = re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())
print(elapsed, int(peak[1]) / 1024)
"""
    runs = []
    for _ in range(3):
        run = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        runs.append([float(word) for word in run.stdout.split()])
    elapsed, peak = np.min(runs, axis=0)
    assert elapsed < 4.0
    assert peak < 600


def _photo_consistency(light_field, sign_v, sign_u):
    """Mean absolute difference of all views, warped with the ground truth, from the center."""
    disparity = np.asarray(known(light_field.truth).disparity)
    y, x = np.mgrid[: disparity.shape[0], : disparity.shape[1]].astype(np.float32)
    center = np.asarray(light_field.center_view)
    differences = []
    for v, u in zip(*np.nonzero(np.asarray(light_field.available)), strict=True):
        du, dv = np.asarray(light_field.steps[v, u])
        if du == dv == 0:
            continue
        place = x + sign_u * du * disparity, y + sign_v * dv * disparity
        seen = cv2.remap(np.asarray(light_field.views[v, u]), *place, cv2.INTER_LINEAR)
        inside = (place[0] >= 0) & (place[0] <= x.max()) & (place[1] >= 0) & (place[1] <= y.max())
        differences.append(np.abs(seen - center)[inside].mean())
    return 255 * float(np.mean(differences))


@pytest.mark.parametrize(("name", "views"), [("cotton", 81), ("backgammon", 17)])
def test_the_truth_explains_all_views(name, views):
    light_field = load_light_field(shared_data("hci", name))
    assert light_field.views.shape == (9, 9, 512, 512, 3)
    assert int(light_field.available.sum()) == views
    right = _photo_consistency(light_field, 1, 1)
    assert right < 1.0 or name != "cotton"
    for signs in ((1, -1), (-1, 1), (-1, -1)):
        wrong = _photo_consistency(light_field, *signs)
        assert wrong > (2.5 if name == "cotton" else 1.5 * right)
