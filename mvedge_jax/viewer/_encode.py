"""Arrays as text that a page carries: 16-bit codes, differences, deflate, base 64."""

import base64
import zlib
from typing import Any

import cv2
import numpy as np

# The code of what is not known; the others divide the range evenly.
_UNKNOWN = 65535
_STEPS = 65534


def text_of(data: bytes) -> str:
    """Bytes in base 64."""
    return base64.b64encode(data).decode("ascii")


def packed(values: np.ndarray, *, log: bool = False) -> dict[str, Any]:
    """An array as codes of 16 bits, differences along its last axis, for `numbers` of the page.

    With `log`, the range of the logarithm is divided. What is not finite, or not positive with
    `log`, is not known. Off by at most half of a 65534th of the range.
    """
    values = np.asarray(values, np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = np.log(values) if log else values
    known = np.isfinite(scaled)
    low = float(scaled[known].min()) if known.any() else 0.0
    high = float(scaled[known].max()) if known.any() else 1.0
    step = (high - low) / _STEPS or 1.0
    codes = np.where(known, np.round((np.where(known, scaled, low) - low) / step), _UNKNOWN)
    codes = codes.astype(np.uint16)
    codes[..., 1:] -= codes[..., :-1].copy()  # modulo 2^16
    planes = np.stack([codes & 255, codes >> 8]).astype(np.uint8)
    return {
        "shape": list(values.shape),
        "low": low,
        "high": low + step * _STEPS,
        "log": log,
        "data": text_of(zlib.compress(planes.tobytes(), 9)),
    }


def packed_labels(labels: np.ndarray) -> dict[str, Any]:
    """Whole numbers as they are, for `labels` of the page."""
    codes = np.asarray(labels).astype("<i4")
    return {"shape": list(codes.shape), "data": text_of(zlib.compress(codes.tobytes(), 9))}


def picture(view: np.ndarray, quality: int) -> str:
    """A view, sRGB in [0, 1], as WebP in base 64; a ValueError if it is too large for that.

    A quality of 100 keeps the view's 8 bits, less halves the resolution of color, too.
    """
    if max(view.shape[:2]) > 16383:
        raise ValueError(
            f"views of {view.shape[1]}x{view.shape[0]} px are too large for the page, which takes "
            "16383 px a side; --scale makes them smaller."
        )
    levels = np.round(255 * np.clip(view, 0, 1)).astype(np.uint8)[..., ::-1]
    # Above 100, OpenCV writes without loss.
    options = [cv2.IMWRITE_WEBP_QUALITY, quality if quality < 100 else 101]
    done, data = cv2.imencode(".webp", levels, options)
    if not done:
        raise ValueError("OpenCV could not write a view as WebP; another build of it may.")
    return text_of(data.tobytes())
