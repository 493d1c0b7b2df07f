"""Point clouds as PLY files: positions, normals, colors and standard errors."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip


def write_ply(
    path: Path,
    points: Float[np.ndarray, "m 3"],
    *,
    colors: UInt8[np.ndarray, "m 3"] | None = None,
    normals: Float[np.ndarray, "m 3"] | None = None,
    error: Float[np.ndarray, " m"] | None = None,
) -> None:
    """Writes a point cloud in binary form.

    Args:
        path: the file.
        points: positions; float64 is stored as such, others as float32.
        colors: sRGB.
        normals: unit vectors.
        error: standard error of each point along the line of sight, in the unit of the places; a
            property `error` of the file.
    """
    fields, columns = [], []
    places = "f8" if points.dtype == np.float64 else "f4"
    for names, values, form in (
        (("x", "y", "z"), points, places),
        (("nx", "ny", "nz"), normals, "f4"),
        (("red", "green", "blue"), colors, "u1"),
        (("error",), None if error is None else np.asarray(error)[:, None], "f4"),
    ):
        if values is not None:
            fields += [(name, "<" + form) for name in names]
            columns += [(name, values[:, i]) for i, name in enumerate(names)]
    table = np.empty(len(points), np.dtype(fields))
    for name, column in columns:
        table[name] = column
    kinds = {"<f4": "float", "<f8": "double", "<u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", "comment made by mvedge_jax"]
    header += [f"element vertex {len(points)}"]
    header += [f"property {kinds[form]} {name}" for name, form in fields]
    with open(path, "wb") as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
        file.write(table.tobytes())


def from_origin(
    points: Float[np.ndarray, "*n 3"], origin: tuple[float, float, float]
) -> Float[np.ndarray, "*n 3"]:
    """Converts positions relative to an origin to world coordinates.

    Args:
        points: relative to the origin.
        origin: see `mvedge_jax.posed.Photographs`.

    Returns:
        Unchanged for an origin of 0; else float64, because float32 would lose precision.
    """
    return points.astype(np.float64) + origin if any(origin) else points


def read_ply(path: Path) -> Float[np.ndarray, "m 3"]:
    """Reads the positions of a point cloud.

    Args:
        path: a PLY file, text or binary, whose first element is `vertex` without lists.

    Returns:
        The positions.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is not PLY, has no points with x, y and z first, or is truncated.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing; expected a PLY file.")
    data = path.read_bytes()
    head, found, body = data.partition(b"end_header\n")
    if not found:
        head, found, body = data.partition(b"end_header\r\n")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    if not found or not lines or lines[0] != ["ply"]:
        raise ValueError(f"{path} has no header of a PLY file.")
    form, count, fields = "", -1, []
    for words in lines[1:]:
        if words[:1] == ["format"] and len(words) > 1:
            form = words[1]
        elif words[:1] == ["element"]:
            if count >= 0:
                break
            if len(words) != 3 or words[1] != "vertex" or not words[2].isdigit():
                raise ValueError(f"{path} does not begin with its points, but {' '.join(words)!r}.")
            count = int(words[2])
        elif words[:1] == ["property"]:
            if len(words) != 3 or words[1] not in _TYPES:
                raise ValueError(f"{path} has points with {' '.join(words)!r}; expected numbers.")
            fields.append((words[2], _TYPES[words[1]]))
    names = [name for name, _ in fields]
    if count < 0 or not {"x", "y", "z"} <= set(names) or len(set(names)) < len(names):
        raise ValueError(f"{path} has no points with x, y and z.")
    if form == "ascii":
        return _from_text(path, body, names, count)
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(form)
    if order is None:
        raise ValueError(f"{path} has the format {form!r}; expected ascii or binary.")
    dtype = np.dtype([(name, order + kind) for name, kind in fields])
    if count * dtype.itemsize > len(body):
        raise ValueError(
            f"{path} is truncated: {count} points of {dtype.itemsize} bytes are announced, "
            f"{len(body)} bytes are there."
        )
    table = np.frombuffer(body, dtype, count)
    return np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64)


def _from_text(path: Path, body: bytes, names: list[str], count: int) -> np.ndarray:
    rows = body.decode("ascii", "replace").splitlines()[:count]
    try:
        values = np.asarray([[float(w) for w in row.split()] for row in rows], np.float64)
    except ValueError:
        values = np.zeros((0, 0))
    if count == 0:
        return np.zeros((0, 3))
    if values.shape != (count, len(names)):
        raise ValueError(f"{path} does not hold the {count} points that its header announces.")
    return values[:, [names.index(axis) for axis in "xyz"]]
