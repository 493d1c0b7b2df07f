"""Image features to compare: colors, a filter bank, or the first layers of VGG16."""

import zipfile
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mvedge_jax._params import cast, number
from mvedge_jax._product import FULL
from mvedge_jax.color import srgb_to_gray

# Maximum size of a weight array in bytes; guards against corrupt headers.
_MOST = 10_000_000


def _convolve(planes: Array, kernels: Array) -> Array:
    """Same-size correlation of `[c, y, x]` with `[k, c, h, w]`, borders replicated."""
    ry, rx = kernels.shape[2] // 2, kernels.shape[3] // 2
    padded = jnp.pad(planes, ((0, 0), (ry, ry), (rx, rx)), mode="edge")
    convolved = jax.lax.conv_general_dilated(padded[None], kernels, (1, 1), "VALID", precision=FULL)
    return convolved[0]


class Colors(eqx.Module):
    """The image itself: `features(image) -> [c, y, x]` is the identity."""

    def __call__(self, image: Float[Array, "c y x"]) -> Float[Array, "c y x"]:
        """Returns the image."""
        return image


class FilterBank(eqx.Module):
    """Colors, and Gabor filters of the gray image at several scales and orientations.

    A stand-in for the first layers of a network. Filters are zero-mean, of unit absolute sum.

    Attributes:
        wavelengths: px per period, one per scale.
        gain: weight of the filters beside the colors.
        orientations: number of orientations per scale.
        radius: half-width of the filters, px.

    Example:
        >>> import jax.numpy as jnp
        >>> FilterBank()(jnp.ones((3, 8, 9))).shape
        (19, 8, 9)
    """

    wavelengths: Float[Array, "s"] = number((3.0, 6.0))
    gain: Float[Array, ""] = number(1.0)
    orientations: int = eqx.field(static=True, default=4)
    radius: int = eqx.field(static=True, default=5)

    def kernels(self, dtype: np.dtype) -> Float[Array, "k 1 h w"]:
        """Even and odd filters of all scales and orientations."""
        params = cast(self, dtype)
        axis = jnp.arange(-self.radius, self.radius + 1, dtype=dtype)
        y, x = jnp.meshgrid(axis, axis, indexing="ij")
        angle = jnp.arange(self.orientations, dtype=dtype) * (jnp.pi / self.orientations)

        def one(wavelength: Array, angle: Array) -> Array:
            along = x * jnp.cos(angle) + y * jnp.sin(angle)
            window = jnp.exp(-(x**2 + y**2) / (2 * (0.4 * wavelength) ** 2))
            phase = along * (2 * jnp.pi / wavelength)
            even = window * jnp.cos(phase)
            even = even - window * (jnp.sum(even) / jnp.sum(window))
            odd = window * jnp.sin(phase)
            return jnp.stack([k / jnp.sum(jnp.abs(k)) for k in (even, odd)])

        bank = jax.vmap(jax.vmap(one, (None, 0)), (0, None))(params.wavelengths, angle)
        return bank.reshape(-1, 1, *x.shape)

    def __call__(self, image: Float[Array, "c y x"]) -> Float[Array, "k y x"]:
        """Returns the colors and the filters' responses."""
        gray = srgb_to_gray(jnp.moveaxis(image, 0, -1))[None]
        responses = _convolve(gray, self.kernels(image.dtype))
        return jnp.concatenate([image, self.gain.astype(image.dtype) * responses])


class Vgg16(eqx.Module):
    """The first two convolutions of VGG16, with weights from the user's file.

    Attributes:
        first: weights of conv1_1, `[64, 3, 3, 3]`.
        first_bias: its bias.
        second: weights of conv1_2, `[64, 64, 3, 3]`.
        second_bias: its bias.

    Source: Thesis 7.1.5, "Distance".
    """

    first: Float[Array, "64 3 3 3"]
    first_bias: Float[Array, "64"]
    second: Float[Array, "64 64 3 3"]
    second_bias: Float[Array, "64"]

    def __call__(self, image: Float[Array, "3 y x"]) -> Float[Array, "64 y x"]:
        """Returns the activations behind the second convolution."""
        params = cast(self, image.dtype)
        # The statistics of ImageNet by which the network's inputs were standardized.
        mean = jnp.asarray([0.485, 0.456, 0.406], image.dtype)[:, None, None]
        spread = jnp.asarray([0.229, 0.224, 0.225], image.dtype)[:, None, None]
        hidden = (image - mean) / spread
        for kernel, bias in (
            (params.first, params.first_bias),
            (params.second, params.second_bias),
        ):
            hidden = jax.nn.relu(_convolve(hidden, kernel) + bias[:, None, None])
        return hidden


def load_vgg16(path: str | Path) -> Vgg16:
    """Reads the first two convolutions of VGG16 from an `.npz` file.

    Args:
        path: file with arrays named as in torchvision: `features.0.weight`, `features.0.bias`,
            `features.2.weight` and `features.2.bias`. To make one:
            `numpy.savez(path, **{k: v.numpy() for k, v in state_dict.items() if k[9] in "02"})`.

    Returns:
        The feature extractor.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: an array is missing or has another shape.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"There is no file of VGG16 weights at {path}. The weights are not part of the "
            "package: export `features.0` and `features.2` of torchvision's vgg16 to an .npz "
            "file, or use FilterBank(), which needs none."
        )
    shapes = {
        "features.0.weight": (64, 3, 3, 3),
        "features.0.bias": (64,),
        "features.2.weight": (64, 64, 3, 3),
        "features.2.bias": (64,),
    }
    arrays = []
    if not zipfile.is_zipfile(path):
        raise ValueError(f"{path} is not an .npz file; expected one with {', '.join(shapes)}.")
    # Given a name, NumPy leaves what is no archive open.
    with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as file:
        for name, shape in shapes.items():
            if name not in file:
                raise ValueError(f"{path} has no array {name!r}; it has {sorted(file)[:8]}.")
            if name in file.zip.namelist() or file.zip.getinfo(f"{name}.npy").file_size > _MOST:
                raise ValueError(
                    f"{name!r} in {path} is no array of {shape}, or claims more than {_MOST} bytes."
                )
            if file[name].shape != shape:
                raise ValueError(
                    f"{name!r} in {path} has the shape {file[name].shape}, expected {shape}."
                )
            arrays.append(jnp.asarray(file[name]))
    return Vgg16(*arrays)
