"""Walks the public API and the sources, and enforces their conventions (CONTRIBUTING.md)."""

import ast
import functools
import importlib
import inspect
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import equinox as eqx

import mvedge_jax

_PACKAGE = Path(mvedge_jax.__file__).parent


def _public_objects():
    """Functions and classes by where they are given away, but for the command line's."""
    walk = pkgutil.walk_packages([str(_PACKAGE)], "mvedge_jax.")
    names = [info.name for info in walk if "._" not in info.name]
    seen = {}
    for module_name in ["mvedge_jax", *names]:
        if module_name == "mvedge_jax.cli":  # its arguments are paths and figures
            continue
        module = importlib.import_module(module_name)
        for name, value in vars(module).items():
            home = getattr(value, "__module__", None) or ""
            if name.startswith("_") or not home.startswith(module_name):
                continue
            if inspect.isfunction(inspect.unwrap(value)) or inspect.isclass(value):
                seen[id(value)] = (f"{module_name}.{name}", value)
    return dict(sorted(seen.values(), key=lambda item: item[0]))


_OBJECTS = _public_objects()
_FUNCTIONS = [name for name, value in _OBJECTS.items() if not inspect.isclass(value)]
_CLASSES = [name for name, value in _OBJECTS.items() if inspect.isclass(value)]


def _wrong_in_function(name: str) -> Iterator[str]:
    doc, signature = inspect.getdoc(_OBJECTS[name]) or "", inspect.signature(_OBJECTS[name])
    given = list(signature.parameters.values())
    if not doc.partition("\n")[0].endswith("."):
        yield "no docstring whose first line is a sentence"
    yield from (f"`{p.name}` is not described" for p in given if not _described(p.name, doc))
    if given and "Args:" not in doc:
        yield "no Args section"
    silent = str(signature).endswith("-> None") or "->" not in str(signature)
    if not (silent or "Returns:" in doc or "Yields:" in doc):
        yield "it does not say what it returns"
    yield from (f"`{p.name}` is not annotated" for p in given if p.annotation is p.empty)
    if signature.return_annotation is inspect.Signature.empty:
        yield "the return value is not annotated"
    positional = [p for p in given if p.kind is not p.KEYWORD_ONLY]
    yield from (f"option `{p.name}` is positional" for p in positional if p.default is not p.empty)
    names = [p.name for p in positional]
    if "key" in [*names, *(p.name for p in given[:-1])]:
        yield "`key` must be keyword-only and last"
    # What else follows parameters is static: shapes.
    last = ("params", "widths", "shape", "sizes", "raster")
    last = [name for name in last if name in names[1:]]
    if last and names[-len(last) :] != last:
        yield f"data, parameters, sizes are not in order: {names}"


def _described(name: str, doc: str) -> bool:
    return f"{name}:" in doc or f"{name} (" in doc


def _wrong_in_class(name: str) -> Iterator[str]:
    value = _OBJECTS[name]
    if not inspect.getdoc(value):
        yield "no docstring"
    # What a class adds to another is described there, the rest where it comes from.
    doc = "".join(inspect.getdoc(kind) or "" for kind in value.__mro__)
    fields = getattr(value, "__dataclass_fields__", None) or getattr(value, "_fields", ())
    public = [field for field in fields if not field.startswith("_")]
    yield from (f"`{field}` is not described" for field in public if f"{field}:" not in doc)
    if issubclass(value, eqx.Module):
        for field in value.__dataclass_fields__.values():
            if not field.metadata.get("static") and field.type in (float, "float"):
                yield f"`{field.name}` is a Python float, which retraces; use `number`"


def _offenders(wrong_in, names) -> dict[str, list[str]]:
    found = {name: list(wrong_in(name)) for name in names}
    return {name: wrong for name, wrong in found.items() if wrong}


def test_functions_are_documented_and_take_data_then_options_then_a_key():
    assert _offenders(_wrong_in_function, _FUNCTIONS) == {}


def test_classes_describe_their_fields_and_retrace_for_no_value():
    assert _offenders(_wrong_in_class, _CLASSES) == {}


_IMPORTED = """
import sys, jax
before = dict(jax.config.values)
import mvedge_jax
assert dict(jax.config.values) == before
import jax._src.xla_bridge as bridge
assert not bridge._backends, bridge._backends
heavy = {
    "cv2", "h5py", "matplotlib", "optax", "optimistix", "optuna", "PIL", "rich", "scipy", "tyro",
} & set(sys.modules)
assert not heavy, heavy
later = set(dir(mvedge_jax)) - set(vars(mvedge_jax))
assert {"load_light_field", "Renderer", "fit_edges", "model", "datasets", "plotting"} <= later
for name in later:
    getattr(mvedge_jax, name)
assert mvedge_jax.model.Renderer is mvedge_jax.Renderer
"""


def test_importing_has_no_side_effects_and_loads_no_library_that_the_chain_does_not_need():
    subprocess.run([sys.executable, "-c", _IMPORTED], check=True)


# A module imports only from floors below its own.
_FLOORS = (
    ("_stored",),
    ("_export", "_params", "_paths", "_linear_map", "_product", "_checkpoint", "_root"),
    ("_cpu", "_pullback"),
    ("_compiler", "_known", "color", "image", "interpolation"),
    ("_batched", "_split_jit"),
    ("_checks",),
    ("_positions",),
    ("lightfield",),
    ("_stored_views",),
    ("_crosshair",),
    ("photometry",),
    ("diffusion", "splatting", "warping", "epi"),
    ("smoothness", "edges", "losses", "metrics"),
    ("depth",),
    ("model", "all_views", "tiles"),
    ("edit", "posed", "superpixels"),
    ("_cache", "_settings", "datasets", "plotting"),
    ("learn", "sweep", "viewer"),
    ("cli",),
    ("__init__", "__main__"),
)
_LEVEL = {name: level for level, names in enumerate(_FLOORS) for name in names}
# Where files are read, written and shown, and people are spoken to.
_HOST_ROOMS = {"cli", "datasets", "learn", "plotting", "sweep", "viewer"}
_HOST_LIBRARIES = {"cv2", "h5py", "matplotlib", "rich", "tyro", "tqdm"}
_CHAIN = {"depth", "edges", "smoothness", "splatting", "diffusion", "warping", "epi", "photometry"}
# Names that a package, or a room in it, gives away. What needs more is two rooms.
_MOST = {"plotting": 17, "depth": 17, "edges/sides": 16}
_FILES = [path.relative_to(_PACKAGE).as_posix() for path in sorted(_PACKAGE.rglob("*.py"))]


@functools.cache
def _tree(file: str) -> ast.Module:
    return ast.parse((_PACKAGE / file).read_text())


def _room(file: str) -> str:
    return file.partition("/")[0].removesuffix(".py")


def _imports(file: str) -> Iterator[tuple[str, ...]]:
    """What a file imports, as parts of a path; what is of the package starts with an empty one."""
    here = Path(file).parts[:-1]
    for node in ast.walk(_tree(file)):
        if isinstance(node, ast.Import):
            found = [tuple(name.name.split(".")) for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            module: tuple[str, ...] = tuple(node.module.split(".")) if node.module else ()
            if node.level:
                module = (_PACKAGE.name, *here[: len(here) - node.level + 1], *module)
            whole = module == (_PACKAGE.name,)
            found = [(*module, name.name) for name in node.names] if whole else [module]
        else:
            continue
        yield from (("", *parts[1:]) if parts[:1] == (_PACKAGE.name,) else parts for parts in found)


def _wrong_in_file(file: str) -> Iterator[str]:
    own, text = _room(file), (_PACKAGE / file).read_text()
    if own not in _LEVEL:
        yield "a room without a floor"
        return
    for first, *parts in _imports(file):
        if first == "" and parts and parts[0] != own:
            if _LEVEL[parts[0]] >= _LEVEL[own]:
                yield f"imports from above: {parts}"
            if any(part.startswith("_") for part in parts[1:]):
                yield f"imports what is private: {parts}"
        elif first in _HOST_LIBRARIES and own not in _HOST_ROOMS:
            yield f"a library of the rim: {first}"
    nodes = list(ast.walk(_tree(file)))
    calls = [node.func for node in nodes if isinstance(node, ast.Call)]
    if own not in _HOST_ROOMS and any(getattr(call, "id", "") == "print" for call in calls):
        yield "prints"
    if len(text.splitlines()) > 350:
        yield "too long to be one idea"
    if "shared/" in text or str(_PACKAGE.parent) in text:
        yield "mentions development data"
    # Numbers and static sizes are fields of the part that they belong to.
    classes = [node.name for node in nodes if isinstance(node, ast.ClassDef)]
    yield from (f"class {name}" for name in classes if name.endswith(("Params", "Sizes")))
    folder = Path(file).parent.as_posix()
    if Path(file).name == "__init__.py" and folder != ".":
        imports = [node for node in _tree(file).body if isinstance(node, ast.ImportFrom)]
        given = [alias.asname for node in imports for alias in node.names if alias.asname]
        if len(given) > _MOST.get(folder, 14):
            yield f"exports {len(given)} names: {given}"


def test_files_keep_to_their_floor_and_are_one_idea_and_the_host_stays_at_the_rim():
    assert _offenders(_wrong_in_file, _FILES) == {}


_ARITHMETIC = ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop


def _float_constants(file: str) -> Iterator[str]:
    """Names at the top of a module that hold floats, alone or in a tuple."""
    for statement in _tree(file).body:
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
            continue
        numbers = statement.value.elts if isinstance(statement.value, ast.Tuple) else []
        for number in numbers or [statement.value]:
            parts = list(ast.walk(number))
            divided = [isinstance(p, ast.Div) for p in parts]
            floats = [isinstance(getattr(p, "value", None), float) for p in parts]
            if all(isinstance(p, _ARITHMETIC) for p in parts) and any(divided + floats):
                yield f"{file}: {ast.unparse(statement)}"


def test_what_is_tuned_in_the_chain_is_a_number_of_a_part():
    """Constants are formats and guards: nothing that a user may want to set, or to learn."""
    files = [file for file in _FILES if _room(file) in _CHAIN]
    found = [constant for file in files for constant in _float_constants(file)]
    assert len(found) <= 12, found
