"""The HCI 4D light field benchmark: `input_CamNNN.png`, `parameters.cfg`, `gt_disp_lowres.pfm`."""

import configparser
import math
import re
from pathlib import Path

import numpy as np

from mvedge_jax.lightfield import Camera

from ._images import image_size, read_raw
from ._limits import check_grid, read_text
from ._pfm import read_pfm
from ._source import Source, Truth, check_truth, image_source

_VIEW = re.compile(r"input_Cam(\d+)\.(?:png|jpg|jpeg|bmp)", re.IGNORECASE)


def is_hci(names: list[str]) -> bool:
    """Whether a folder with these file names is in the benchmark's layout."""
    return any(_VIEW.fullmatch(name) for name in names)


def open_hci(path: Path, names: list[str]) -> Source:
    """Opens a scene folder of the HCI 4D benchmark.

    Views are numbered row by row, `NNN = columns * row + column`. Without `parameters.cfg` the
    grid is the smallest odd square that holds the highest number, so that a folder with the
    crosshair alone is recognized.
    """
    numbers: dict[int, str] = {}
    for name in names:
        match = _VIEW.fullmatch(name)
        if match is None:
            continue
        number = int(match[1])
        if number in numbers:
            raise ValueError(
                f"{path / name} and {path / numbers[number]} are both view {number}; expected one "
                "image per view."
            )
        numbers[number] = name
    settings = _Settings(path / "parameters.cfg") if "parameters.cfg" in names else None
    grid = settings.grid() if settings else None
    if grid is None:
        side = math.isqrt(max(numbers)) + 1
        side += side % 2 == 0
        grid = (side, side)
        check_grid(path / numbers[max(numbers)], side, side)
    rows, columns = grid
    if max(numbers) >= rows * columns:
        raise ValueError(
            f"{path / numbers[max(numbers)]} lies outside the grid of {rows}x{columns} views that "
            f"parameters.cfg promises; expected numbers up to {rows * columns - 1:03d}."
        )
    files = {divmod(number, columns): path / name for number, name in numbers.items()}
    center = columns * (rows // 2) + columns // 2
    return image_source(
        path,
        "HCI 4D benchmark",
        files,
        grid,
        lambda row, column: f"input_Cam{columns * row + column:03d}.png",
        truth=_truth_reader(path, names, grid, center),
        camera=settings.camera() if settings else None,
        disparity_range=settings.disparity_range() if settings else None,
        size=settings.size() if settings else None,
        positions=settings.positions(grid) if settings else None,
        in_steps=True,
    )


class _Settings:
    """`parameters.cfg`. Missing entries are None; malformed ones are errors."""

    def __init__(self, path: Path):
        self._path = path
        self._parser = configparser.ConfigParser(interpolation=None)
        text = read_text(path)
        try:
            self._parser.read_string(text)
        except configparser.Error as error:
            raise ValueError(
                f"{path} cannot be read as a configuration file: {_reason(error)}."
            ) from error

    def _numbers(
        self, section: str, *keys: str, infinite: tuple[str, ...] = ()
    ) -> list[float] | None:
        """Numbers by their names, None unless all are given; `infinite` ones may be infinite."""
        texts = [self._parser.get(section, key, fallback=None) for key in keys]
        if any(text is None for text in texts):
            return None
        values = []
        for key, text in zip(keys, texts, strict=True):
            try:
                value = float(str(text))
            except ValueError:
                value = math.nan
            if not (math.isfinite(value) or (key in infinite and value == math.inf)):
                raise ValueError(
                    f"{self._path} says {key} = {str(text)[:60]!r} in [{section}]; expected a "
                    "finite number."
                )
            values.append(value)
        return values

    def grid(self) -> tuple[int, int] | None:
        values = self._numbers("extrinsics", "num_cams_y", "num_cams_x")
        if values is None:
            return None
        if min(values) < 1 or any(value != int(value) for value in values):
            raise ValueError(
                f"{self._path} promises {values[0]:g} x {values[1]:g} cameras; expected positive "
                "whole numbers."
            )
        check_grid(self._path, int(values[0]), int(values[1]))
        return int(values[0]), int(values[1])

    def size(self) -> tuple[int, int, str] | None:
        values = self._numbers("intrinsics", "image_resolution_y_px", "image_resolution_x_px")
        if values is None:
            return None
        if min(values) < 1:
            raise ValueError(
                f"{self._path} promises views of {values[0]:g}x{values[1]:g} px (height x width); "
                "expected positive numbers."
            )
        return int(values[0]), int(values[1]), str(self._path)

    def positions(self, grid: tuple[int, int]) -> np.ndarray | None:
        """Positions of all views in view steps, as `write_hci` writes them; row by row."""
        found = []
        for key in ("positions_x", "positions_y"):
            text = self._parser.get("extrinsics", key, fallback=None)
            if text is None:
                return None
            try:
                values = np.array([float(part) for part in text.split()])
            except ValueError:
                values = np.array(np.nan)
            if values.size != grid[0] * grid[1] or not np.isfinite(values).all():
                raise ValueError(
                    f"{self._path} says {key} = {text[:60]!r} in [extrinsics]; expected a finite "
                    f"number for each of the {grid[0]}x{grid[1]} views, row by row."
                )
            found.append(values.reshape(grid))
        return np.stack(found, axis=-1)

    def camera(self) -> Camera | None:
        """The geometry; the sensor's size is that of the longer side of the image."""
        intrinsics = self._numbers(
            "intrinsics",
            "focal_length_mm",
            "sensor_size_mm",
            "image_resolution_y_px",
            "image_resolution_x_px",
        )
        extrinsics = self._numbers(
            "extrinsics", "baseline_mm", "focus_distance_m", infinite=("focus_distance_m",)
        )
        if intrinsics is None or extrinsics is None:
            return None
        focal, sensor, *size = intrinsics
        baseline, focus = extrinsics
        if min(focal, sensor, baseline, focus) <= 0:
            raise ValueError(
                f"{self._path} must give positive focal_length_mm, sensor_size_mm, baseline_mm and "
                f"focus_distance_m, got {focal:g}, {sensor:g}, {baseline:g} and {focus:g}."
            )
        return Camera(focal * max(size) / sensor, baseline / 1000, focus)

    def disparity_range(self) -> tuple[float, float] | None:
        values = self._numbers("meta", "disp_min", "disp_max")
        if values is None:
            return None
        low, high = values
        if not low < high:
            raise ValueError(
                f"{self._path} says disp_min = {low:g} and disp_max = {high:g}; expected the first "
                "to be smaller."
            )
        return low, high


def _reason(error: configparser.Error) -> str:
    """The message of the parser, without its placeholder for the file name."""
    lines = getattr(error, "errors", ())
    if lines:
        line, text = lines[0]
        return f"line {line} is neither `[section]` nor `key = value`, {str(text)[:60]}"
    text = str(error).splitlines()[0]
    return re.sub(r"While reading from '<string>' *", "", text)[:200].rstrip(".")


def _truth_reader(path: Path, names: list[str], grid: tuple[int, int], center: int):
    single = [f"gt_disp_lowres_Cam{number:03d}.pfm" for number in range(grid[0] * grid[1])]
    chosen = next((n for n in ("gt_disp_lowres.pfm", single[center]) if n in names), None)
    if chosen is None:
        return None

    def disparity(name: str) -> np.ndarray:
        values = read_pfm(path / name)
        check_truth(values, path / name)
        return values

    def ids(name: str, shape: tuple[int, ...]) -> np.ndarray:
        size = image_size(path / name)
        values = read_raw(path / name) if size == shape else np.empty(size)
        if values.shape != shape:
            raise ValueError(
                f"{path / name} has the shape {values.shape}; expected one id per pixel, {shape}."
            )
        return values.astype(np.int32)

    def read() -> Truth:
        center_disparity = disparity(chosen)
        shape = center_disparity.shape
        every = id_names = None
        if all(name in names for name in single):
            every = np.empty((*grid, *shape), np.float32)
            for number, name in enumerate(single):
                values = disparity(name)
                if values.shape != shape:
                    raise ValueError(
                        f"{path / name} has the size {values.shape}; expected {shape}, as {chosen}."
                    )
                every[divmod(number, grid[1])] = values
        id_names = [f"objectids_lowres_Cam{number:03d}.png" for number in range(len(single))]
        object_name = next(
            (n for n in ("objectids_lowres.png", id_names[center]) if n in names), None
        )
        every_id = None
        if all(name in names for name in id_names):
            every_id = np.stack([ids(name, shape) for name in id_names]).reshape(*grid, *shape)
        return Truth(
            center_disparity,
            np.ones(shape, bool),
            None if object_name is None else ids(object_name, shape),
            every,
            every_id,
        )

    return read
