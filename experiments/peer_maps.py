"""Published disparity maps of other methods, scored by our metrics on the pixels of our tables.

The development data have maps of a learning-free method (SPO) and of two networks (FastLFnet,
EPINET). Columns are those of Table 6.1: full frame, and without 15 px along the border. A map that
is smaller than the views lacks a margin on every side; its first columns are of what it has.

    python experiments/peer_maps.py --out results/peer_maps
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax.numpy as jnp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._report import print_table, shared_data, write_json
from experiments._scenes import find_scene
from mvedge_jax.datasets import read_pfm
from mvedge_jax.lightfield import GroundTruth
from mvedge_jax.metrics import depth_scores

NAMES = {"spo": "SPO", "fastlfnet": "FastLFnet", "epinet": "EPINET"}
# Our own maps have no part in it.
_DEPENDS = ("experiments/peer_maps.py", "mvedge_jax/datasets/*.py", "mvedge_jax/metrics/*.py")


def peer_rows(data: Path | None, scene: str, truth: GroundTruth) -> Iterator[dict[str, Any]]:
    """One row per published map of a scene; none where there are no maps."""
    if data is None:
        return
    for path in sorted((data / "peer_results").glob(f"*/{Path(scene).name}.pfm")):
        disparity = jnp.asarray(read_pfm(path))
        side, known = disparity.shape[0], truth.disparity.shape[0]
        margin = (known - side) // 2
        if disparity.shape[0] != disparity.shape[1] or known != side + 2 * margin or margin > 15:
            raise ValueError(
                f"{path} has {disparity.shape} px; expected the views' {truth.disparity.shape}, or "
                "at most 15 less on each side."
            )
        part = slice(margin, known - margin)
        found, valid = truth.disparity[part, part], truth.valid[part, part]
        scores = depth_scores(disparity, found, mask=valid)
        inner = depth_scores(disparity, found, mask=valid, crop=15 - margin)
        yield {
            "scene": Path(scene).name,
            "method": NAMES.get(path.parent.name, path.parent.name),
            "MSE*100": float(scores.mse),
            "Q25*100": float(scores.q25),
            "BP(.01)": float(scores.bad_01),
            "BP(.03)": float(scores.bad_03),
            "BP(.07)": float(scores.bad_07),
            "MSE*100 crop 15": float(inner.mse),
            "BP(.07) crop 15": float(inner.bad_07),
            "margin px": margin,
            "source": f"published map, {path.relative_to(data).as_posix()}",
        }


def main() -> None:
    """Scores every map whose scene is there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/peer_maps"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="+", default=["cotton", "backgammon"])
    arguments = parser.parse_args()
    rows = []
    for name in arguments.scenes:
        truth = find_scene(name, arguments.data, size=512).truth
        if truth is None:
            raise ValueError(f"scene {name} has no ground truth to score against.")
        rows += peer_rows(arguments.data, name, truth)
    print_table(rows, title="published maps")
    write_json(arguments.out / "peer_maps.json", rows, depends=_DEPENDS)


if __name__ == "__main__":
    main()
