"""`mvedge view`: a light field and what was computed from it, in a browser."""

import webbrowser
import zipfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from mvedge_jax import viewer
from mvedge_jax.datasets import load_light_field
from mvedge_jax.lightfield import LightField

from ._common import note, stage
from ._gathered import gather
from ._interruption import unfinished
from ._source import read_json, scene_of
from ._view_maps import view_maps

# Files that identify a folder of results.
_MAP, _LABELS = "disparity.pfm", "labels.npy"


def view(
    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE|RESULT")],
    /,
    *,
    other: Annotated[Path | None, tyro.conf.arg(metavar="RESULT")] = None,
    scene: Annotated[Path | None, tyro.conf.arg(metavar="SCENE")] = None,
    reference: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    superpixels: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None,
    hidden: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None,
    html: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    quality: int = 90,
    views: int | None = None,
    scale: float = 1.0,
    host: str = "127.0.0.1",
    port: int = 8765,
    no_browser: bool = False,
    overwrite: bool = False,
) -> None:
    """Shows a light field, and results of it, in a browser.

    Parallax, refocusing with a synthetic aperture, EPIs with their lines, the map and its error,
    points in space, two results compared, a picture put into the scene. The page loads nothing from
    elsewhere; without --html it is served to this machine alone until Ctrl-C.

    Args:
        path: folder or file of a light field, or a result of `mvedge depth`, `optimize` or
            `stereo`.
        other: a second result of the same scene, to compare; a folder or, of a light field, a .pfm
            map.
        scene: the light field, if the result does not name it or it has moved.
        reference: photograph of a `mvedge stereo` result to show; by default the first one.
        superpixels: result of `mvedge superpixels` for the scene, shown as colors.
        hidden: result of `mvedge views` for the scene: adds surfaces that the center view does not
            show.
        html: write one self-contained file, .html, instead of serving it.
        quality: image quality of the views, 1 to 100 (lossless); less makes the page smaller.
        views: of a SCENE, the central VIEWS x VIEWS only; odd.
        scale: of a SCENE, shrink the views by this factor, at most 1.
        host: address to serve at; others than 127.0.0.1 let other machines look.
        port: first port to try.
        no_browser: do not open a browser.
        overwrite: replace FILE.
    """
    if html is not None:
        _refuse(html, overwrite)
    page = {"html": html, "quality": quality, "host": host, "port": port, "quiet": no_browser}
    if _is_stereo(path):
        given = {"--scene": scene, "--superpixels": superpixels, "--hidden": hidden}
        if wrong := [option for option, value in given.items() if value is not None]:
            raise ValueError(f"{wrong[0]} is for light fields; {path} is what `stereo` wrote.")
        with stage(f"reading {path}"):
            light_field, results = _photograph(path, other, reference)
        return show(light_field, results, **page)
    if reference is not None:
        raise ValueError(f"--reference is for what `stereo` wrote, which {path} is not.")
    is_result = path.suffix == ".pfm" or (path / _MAP).is_file()
    reading = {"views": views, "scale": scale}
    source = path if scene is None else scene
    if is_result and scene is None:
        source, reading = scene_of(path, advice="name it: --scene")
    with stage(f"reading {source}"):
        light_field = load_light_field(source, **reading)
        results = _results([path] if is_result else [], other)
        added = _added(superpixels, hidden, light_field, results)
        results = [result._replace(**added) for result in results]
    return show(light_field, results, **page)


def _is_stereo(path: Path) -> bool:
    """Whether a folder is a result of `mvedge stereo`."""
    file = path / "report.json"
    if not file.is_file():
        return False
    try:
        report = read_json(file)
    except ValueError:  # what needs it will say so
        return False
    return "model" in report and "photographs" in report


def _photograph(
    path: Path, other: Path | None, reference: str | None
) -> tuple[LightField, list[viewer.Result]]:
    """A photograph, and its depth by one or two results."""
    field, results = None, []
    for folder in [path, *([] if other is None else [other])]:
        if not _is_stereo(folder):
            raise ValueError(
                f"--other must be what `mvedge stereo` wrote, as {path}; got {folder}."
            )
        found = gather(folder, None)
        names = {index: found.photographs.names[index] for index in found.depth}
        reference = next(iter(names.values()), "") if reference is None else reference
        index = found.photographs.index(reference)
        if index not in names:
            shown = ", ".join(list(names.values())[:8])
            raise ValueError(f"{folder} has no depth of {reference!r}; it has that of {shown}.")
        rows = read_json(folder / "report.json")["photographs"]
        row = next(row for name, row in rows.items() if found.photographs.index(name) == index)
        baseline = row.get("baseline") if isinstance(row, dict) else None
        if not isinstance(baseline, int | float):
            raise ValueError(f"{folder / 'report.json'} does not tell the baseline of {reference}.")
        label = folder.name if other is None or folder.name != other.name else str(folder)
        view, result = viewer.result_of_photograph(
            found.photographs,
            index,
            found.depth[index],
            error=found.error.get(index),
            baseline=baseline,
            name=label,
        )
        field = view if field is None else field
        results.append(result)
    assert field is not None
    return field, results


def show(
    light_field: LightField,
    results: list[viewer.Result],
    *,
    html: Path | None = None,
    quality: int = 90,
    host: str = "127.0.0.1",
    port: int = 8765,
    quiet: bool = False,
) -> None:
    """Writes the page into a file, or serves it until Ctrl-C."""
    with stage("making the page"):
        page = viewer.page(light_field, *results, quality=quality)
    size = f"{len(page.encode()) / 1e6:.1f} MB"
    if html is not None:
        part = html.with_name(f".{html.name}.part")
        with unfinished(part):
            part.write_text(page, encoding="utf-8")
            part.replace(html)
        note(f"{size}; written to {html}")
        return
    with viewer.serve(page, host=host, port=port) as server:
        note(f"{size}; at {server.url} until Ctrl-C")
        if not quiet:
            webbrowser.open(server.url)
        server.serve_forever()


def _refuse(html: Path, overwrite: bool) -> None:
    # So that no light field is replaced.
    if html.suffix not in {".html", ".htm"}:
        raise ValueError(f"--html must name a file that ends in .html, got {html}.")
    if not html.parent.is_dir():
        raise FileNotFoundError(f"{html.parent}, where --html is to be written, is no folder.")
    if html.is_dir():
        raise ValueError(f"{html} is a folder; --html must name a file to write.")
    if html.exists() and not overwrite:
        raise FileExistsError(f"{html} is there already; choose another file or pass --overwrite.")


def _results(paths: list[Path], other: Path | None) -> list[viewer.Result]:
    paths = [*paths, *([] if other is None else [other])]
    results = [viewer.read_result(path) for path in paths]
    if len({result.name for result in results}) < len(results):
        results = [viewer.read_result(path, name=str(path)) for path in paths]
    return results


def _added(
    superpixels: Path | None,
    hidden: Path | None,
    light_field: LightField,
    results: list[viewer.Result],
) -> dict[str, Any]:
    """Results of other commands, for every result."""
    for option, folder in (("--superpixels", superpixels), ("--hidden", hidden)):
        if folder is not None and not results:
            raise ValueError(f"{option} needs a RESULT, with whose map it is shown.")
    added = {}
    if superpixels is not None:
        added["labels"] = _labels(superpixels, light_field)
    if hidden is not None:
        shape = light_field.views.shape[:4]
        maps = view_maps(hidden / "views.h5", shape, "disparity", "error", "source")
        added["hidden"] = viewer.hidden_surfaces(light_field, *maps)
    return added


def _labels(folder: Path, light_field: LightField) -> np.ndarray:
    path = folder / _LABELS
    try:
        with open(path, "rb") as raw:
            labels = np.load(raw)
    except FileNotFoundError:
        raise FileNotFoundError(
            f"{path} is not there; expected the result of `mvedge superpixels`."
        ) from None
    except (ValueError, EOFError, zipfile.BadZipFile) as reason:
        raise ValueError(f"{path} could not be read: {reason}.") from None
    if not isinstance(labels, np.ndarray):
        raise ValueError(f"{path} must hold one array, got an archive.")
    if labels.shape != light_field.views.shape[:4] or labels.dtype.kind not in "iu":
        raise ValueError(
            f"{path} must hold whole numbers of shape {light_field.views.shape[:4]}, got "
            f"{labels.dtype} of shape {labels.shape}."
        )
    return labels[light_field.center]
