"""Rate-distortion of a depth map as points and cuts (8.1.1), beside PNG and JPEG 2000.

The known map of each scene is coded. PNG is lossless: its rates are those of fewer gray levels, 16
bits at most. JPEG 2000 codes 16 bits at several rates. The error is that of what is decoded: root
of the mean square, and pixels that are off by more than a hundredth.

    python experiments/codec.py --scenes demo edges --size 128
    python experiments/codec.py --scenes hci/cotton --points 2000 8000 20000 50000
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import jax.numpy as jnp
import numpy as np
import tyro
from _report import print_table, shared_data, write_csv, write_json
from _scenes import find_scene
from matplotlib.figure import Figure

from mvedge_jax.model.codec import Encoding, decode, encode

OURS, PNG, JPEG = "points and cuts", "PNG", "JPEG 2000"
_LEVELS = (4, 6, 8, 10, 12, 14, 16)
# Per mille of the uncompressed bytes.
_RATES = (2, 5, 10, 20, 40, 80, 160, 320)


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        scenes: rendered ones by name, those of the development data as `hci/cotton`.
        data: the development data.
        size: side of rendered views, px.
        points: of our code, in shares of the pixels.
        out: folder for the table and the curves.
    """

    scenes: tuple[str, ...] = ("demo", "edges")
    data: Path | None = shared_data()
    size: int = 128
    points: tuple[float, ...] = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
    out: Path = Path("results/codec")


def with_points(known: np.ndarray, shares: tuple[float, ...]) -> Iterator[tuple[int, np.ndarray]]:
    """Bytes of the file, and the map that it gives back, for each share of points."""
    for share in shares:
        encoding = encode(jnp.asarray(known), max(round(share * known.size), 1))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "code.mvec"
            size = encoding.save(path)
            yield size, np.asarray(decode(Encoding.load(path)))


def with_pictures(known: np.ndarray, kind: str) -> Iterator[tuple[int, np.ndarray]]:
    """The same for a picture of the map by OpenCV; its range takes 8 bytes more."""
    low, high = float(known.min()), float(known.max())
    for rate in _LEVELS if kind == PNG else _RATES:
        top = 2**rate - 1 if kind == PNG else 65535
        levels = np.round((known - low) / (high - low) * top).astype(np.uint16)
        if kind == PNG:
            levels = levels.astype(np.uint8) if rate <= 8 else levels
            code = cv2.imencode(".png", levels, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
        else:
            code = cv2.imencode(".jp2", levels, [cv2.IMWRITE_JPEG2000_COMPRESSION_X1000, rate])[1]
        back = np.asarray(cv2.imdecode(code, cv2.IMREAD_UNCHANGED), np.float64)
        yield len(code) + 8, low + back / top * (high - low)


def measured(name: str, known: np.ndarray, shares: tuple[float, ...]) -> list[dict[str, Any]]:
    """A row for each code and rate."""
    rows = []
    for code in (OURS, PNG, JPEG):
        coded = with_points(known, shares) if code == OURS else with_pictures(known, code)
        for size, back in coded:
            error = back - known
            rows.append(
                {
                    "scene": name,
                    "code": code,
                    "bytes": size,
                    "bits per pixel": 8 * size / known.size,
                    "rms error px": float(np.sqrt(np.mean(error**2))),
                    "off by .01 %": 100 * float(np.mean(np.abs(error) > 0.01)),
                }
            )
        print(rows[-1], flush=True)
    return rows


def beside(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Bytes that the others need for the error of each of our rates, interpolated."""
    compared = []
    for row in rows:
        if row["code"] != OURS:
            continue
        line = {name: row[name] for name in ("scene", "bytes", "rms error px")}
        for code in (PNG, JPEG):
            theirs = [r for r in rows if r["scene"] == row["scene"] and r["code"] == code]
            theirs.sort(key=lambda r: r["rms error px"])
            errors = np.log([max(r["rms error px"], 1e-9) for r in theirs])
            needed = np.interp(
                np.log(row["rms error px"]), errors, np.log([r["bytes"] for r in theirs])
            )
            line[f"{code} bytes"] = round(float(np.exp(needed)))
            line[f"share of {code}"] = row["bytes"] / float(np.exp(needed))
        compared.append(line)
    return compared


def main() -> None:
    """Codes the maps, prints the tables, draws the curves."""
    arguments = tyro.cli(Arguments, description=__doc__)
    rows: list[dict[str, Any]] = []
    for name in arguments.scenes:
        truth = find_scene(name, arguments.data, size=arguments.size).truth
        if truth is None:
            raise ValueError(f"{name} has no ground truth.")
        known = np.asarray(truth.disparity, np.float64)
        rows += measured(Path(name).name, known, arguments.points)
    compared = beside(rows)
    print_table(rows, title="error against bytes")
    print_table(compared, title="bytes at our errors")
    write_csv(arguments.out / "codec.csv", rows)
    write_json(arguments.out / "codec.json", {"rates": rows, "at equal error": compared})
    figure = Figure(figsize=(4.5 * len(arguments.scenes), 3.8), layout="constrained")
    names = list(dict.fromkeys(row["scene"] for row in rows))
    for axes, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        for code in (OURS, PNG, JPEG):
            mine = [row for row in rows if row["scene"] == name and row["code"] == code]
            across = [row["bits per pixel"] for row in mine]
            axes.loglog(across, [row["rms error px"] for row in mine], "o-", label=code)
        axes.set(title=name, xlabel="bits per pixel", ylabel="rms error, px")
        axes.legend()
    figure.savefig(arguments.out / "codec.png")


if __name__ == "__main__":
    main()
