"""Walks the public API and enforces its conventions (CONTRIBUTING.md)."""

import ast
import importlib
import inspect
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import equinox as eqx
import pytest

import mvedge_jax

_PACKAGE = Path(mvedge_jax.__file__).parent
# The rim speaks to people and files, not to jit: its arguments are paths and figures.
_RIM = {"mvedge_jax.cli"}


def _public_modules():
    names = ["mvedge_jax"]
    for info in pkgutil.walk_packages([str(_PACKAGE)], "mvedge_jax."):
        if not any(part.startswith("_") for part in info.name.split(".")[1:]):
            names.append(info.name)
    return [name for name in names if name not in _RIM]


def _public_objects():
    seen = {}
    for module_name in _public_modules():
        module = importlib.import_module(module_name)
        for name, value in vars(module).items():
            if name.startswith("_") or inspect.ismodule(value):
                continue
            if not (getattr(value, "__module__", None) or "").startswith(module_name):
                continue
            if inspect.isfunction(inspect.unwrap(value)) or inspect.isclass(value):
                seen[id(value)] = (f"{module_name}.{name}", value)
    return sorted(seen.values(), key=lambda item: item[0])


_OBJECTS = _public_objects()
_FUNCTIONS = [(name, value) for name, value in _OBJECTS if not inspect.isclass(value)]
_CLASSES = [(name, value) for name, value in _OBJECTS if inspect.isclass(value)]


def _case(items):
    return pytest.mark.parametrize(
        ("name", "value"), items, ids=[name.removeprefix("mvedge_jax.") for name, _ in items]
    )


def test_the_walk_finds_the_package():
    assert len(_FUNCTIONS) > 10
    assert len(_CLASSES) > 3


@_case(_FUNCTIONS)
def test_function_documents_every_argument(name, value):
    doc = inspect.getdoc(value)
    assert doc, f"{name} has no docstring"
    assert doc.splitlines()[0].endswith("."), f"{name}: the first line is not a sentence"
    parameters = [p for p in inspect.signature(value).parameters if p != "self"]
    missing = [p for p in parameters if f"{p}:" not in doc and f"{p} (" not in doc]
    assert not missing, f"{name} does not describe {missing}"
    if parameters:
        assert "Args:" in doc, f"{name} has no Args section"
    assert (
        "Returns:" in doc
        or "Yields:" in doc
        or "->" not in str(inspect.signature(value))
        or (str(inspect.signature(value)).endswith("-> None"))
    ), f"{name} does not say what it returns"


@_case(_FUNCTIONS)
def test_options_are_keyword_only(name, value):
    offenders = [
        parameter.name
        for parameter in inspect.signature(value).parameters.values()
        if parameter.default is not inspect.Parameter.empty
        and parameter.kind is not inspect.Parameter.KEYWORD_ONLY
    ]
    assert not offenders, f"{name}: {offenders} have defaults and must be keyword-only"


@_case(_FUNCTIONS)
def test_function_is_annotated(name, value):
    signature = inspect.signature(value)
    bare = [
        p.name for p in signature.parameters.values() if p.annotation is inspect.Parameter.empty
    ]
    assert not bare, f"{name}: {bare} have no annotation"
    assert signature.return_annotation is not inspect.Signature.empty, f"{name}: return value"


@_case(_FUNCTIONS)
def test_key_is_last_and_keyword_only(name, value):
    parameters = list(inspect.signature(value).parameters.values())
    for position, parameter in enumerate(parameters):
        if parameter.name == "key":
            assert parameter.kind is inspect.Parameter.KEYWORD_ONLY, name
            assert position == len(parameters) - 1, f"{name}: `key` must come last"


@_case(_FUNCTIONS)
def test_arguments_are_data_parameters_sizes(name, value):
    positional = [
        parameter.name
        for parameter in inspect.signature(value).parameters.values()
        if parameter.kind is not inspect.Parameter.KEYWORD_ONLY
    ]
    # What else follows parameters is static: shapes.
    names = ("params", "widths", "shape", "sizes", "raster")
    last = [n for n in names if n in positional and positional[0] != n]
    assert not last or positional[-len(last) :] == last, f"{name}: {positional}"


@_case(_CLASSES)
def test_class_documents_its_fields(name, value):
    assert inspect.getdoc(value), f"{name} has no docstring"
    # What a class adds to another is described there, the rest where it comes from.
    doc = "".join(inspect.getdoc(kind) or "" for kind in value.__mro__)
    fields = getattr(value, "__dataclass_fields__", None) or getattr(value, "_fields", ())
    missing = [f for f in fields if not f.startswith("_") and f"{f}:" not in doc]
    assert not missing, f"{name} does not describe {missing}"


@_case([(name, value) for name, value in _CLASSES if issubclass(value, eqx.Module)])
def test_no_module_field_retraces_per_value(name, value):
    fields = value.__dataclass_fields__.values()
    traced = [f for f in fields if not f.metadata.get("static")]
    floats = [f.name for f in traced if f.type in (float, "float")]
    assert not floats, f"{name}: {floats} are Python floats, which retrace; use `number`"


def test_importing_has_no_side_effects():
    """No arrays, no configuration and no rim libraries on import of the package."""
    code = (
        "import sys, jax; before = dict(jax.config.values); import mvedge_jax; "
        "assert dict(jax.config.values) == before; "
        "import jax._src.xla_bridge as bridge; assert not bridge._backends, bridge._backends; "
        "assert not {'matplotlib.pyplot', 'tyro', 'rich'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_package_never_mentions_development_data():
    offenders = [
        str(path.relative_to(_PACKAGE))
        for path in _PACKAGE.rglob("*.py")
        if "shared/" in path.read_text() or str(_PACKAGE.parent) in path.read_text()
    ]
    assert not offenders


def test_no_file_is_too_long_to_be_one_idea():
    lengths = {
        str(path.relative_to(_PACKAGE)): len(path.read_text().splitlines())
        for path in _PACKAGE.rglob("*.py")
    }
    assert {name: lines for name, lines in lengths.items() if lines > 350} == {}


def test_no_class_is_named_after_what_it_is_to_the_compiler():
    """Numbers and static sizes are fields of the part that they belong to."""
    found = [
        node.name
        for path in _PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef) and node.name.endswith(("Params", "Sizes"))
    ]
    assert found == []


_FLOORS = (
    ("_stored",),
    ("_export", "_params", "_paths", "_linear_map", "_product", "_checkpoint", "_root"),
    ("_cpu",),
    ("_compiler", "_known", "color", "image", "interpolation"),
    ("_batched", "_checks"),
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


_HEAVY = {
    "cv2",
    "h5py",
    "matplotlib",
    "optax",
    "optimistix",
    "optuna",
    "PIL",
    "rich",
    "scipy",
    "tyro",
}
_IMPORTED = f"""
import sys
import mvedge_jax
heavy = {_HEAVY} & set(sys.modules)
assert not heavy, heavy
later = set(dir(mvedge_jax)) - set(vars(mvedge_jax))
assert {{"load_light_field", "Renderer", "fit_edges", "model", "datasets", "plotting"}} <= later
for name in later:
    getattr(mvedge_jax, name)
assert mvedge_jax.model.Renderer is mvedge_jax.Renderer
"""


def test_the_import_loads_no_library_that_the_chain_does_not_need():
    run = [sys.executable, "-c", _IMPORTED]
    subprocess.run(run, check=True)


def _imports(path: Path) -> Iterator[tuple[str, ...]]:
    """What a file of the package imports of the package, as parts of a path."""
    here = path.relative_to(_PACKAGE).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [name.name.split(".") for name in node.names]
            yield from (tuple(n[1:]) for n in names if n[0] == _PACKAGE.name and len(n) > 1)
        elif isinstance(node, ast.ImportFrom):
            module: tuple[str, ...] = tuple(node.module.split(".")) if node.module else ()
            if node.level:
                module = (*here[: len(here) - node.level + 1], *module)
            elif module[:1] == (_PACKAGE.name,):
                module = module[1:]
            else:
                continue
            yield from [module] if module else [(name.name,) for name in node.names]


def _files() -> Iterator[tuple[str, Path]]:
    for path in sorted(_PACKAGE.rglob("*.py")):
        yield path.relative_to(_PACKAGE).with_suffix("").parts[0], path


def test_every_room_has_a_floor():
    rooms = {name for names in _FLOORS for name in names}
    assert {own for own, _ in _files()} <= rooms


def test_floors_are_not_blurred():
    """A module imports only from floors below it, absolute imports included."""
    level = {name: i for i, names in enumerate(_FLOORS) for name in names}
    offenders = [
        f"{path.relative_to(_PACKAGE)}: {'.'.join(parts)}"
        for own, path in _files()
        for parts in _imports(path)
        if parts[0] != own and level[parts[0]] >= level[own]
    ]
    assert not offenders


def test_private_modules_stay_in_their_package():
    offenders = [
        f"{path.relative_to(_PACKAGE)}: {'.'.join(parts)}"
        for own, path in _files()
        for parts in _imports(path)
        if parts[0] != own and any(part.startswith("_") for part in parts[1:])
    ]
    assert not offenders


_CHAIN = ["depth", "edges", "smoothness", "splatting", "diffusion", "warping", "epi", "photometry"]
_ARITHMETIC = ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop


def _float_constants(path: Path) -> Iterator[str]:
    """Names at the top of a module that hold floats, alone or in a tuple."""
    for statement in ast.parse(path.read_text()).body:
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
            continue
        numbers = statement.value.elts if isinstance(statement.value, ast.Tuple) else []
        for number in numbers or [statement.value]:
            parts = list(ast.walk(number))
            plain = all(isinstance(p, _ARITHMETIC) for p in parts)
            if plain and any(
                isinstance(p, ast.Div) or isinstance(getattr(p, "value", None), float)
                for p in parts
            ):
                yield f"{path.relative_to(_PACKAGE)}: {ast.unparse(statement)}"


def test_what_is_tuned_in_the_chain_is_a_number_of_a_part():
    """Constants are formats and guards: nothing that a user may want to set, or to learn."""
    paths = (path for folder in _CHAIN for path in (_PACKAGE / folder).rglob("*.py"))
    found = [constant for path in paths for constant in _float_constants(path)]
    assert len(found) <= 12, found


# Names that a package, or a room in it, gives away. What needs more is two rooms.
_MOST = 14
_MORE = {"plotting": 17, "depth": 17, "edges/sides": 16}


def test_packages_give_away_few_names():
    for face in _PACKAGE.rglob("__init__.py"):
        if face.parent == _PACKAGE:
            continue
        given = [
            alias.asname
            for node in ast.parse(face.read_text()).body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
            if alias.asname
        ]
        room = face.parent.relative_to(_PACKAGE)
        assert len(given) <= _MORE.get(str(room), _MOST), (
            f"{room} exports {len(given)} names: {given}"
        )


# Where files are read, written and shown, and people are spoken to.
_HOST_ROOMS = {"cli", "datasets", "learn", "plotting", "sweep", "viewer"}
_HOST_LIBRARIES = {"cv2", "h5py", "matplotlib", "rich", "tyro", "tqdm"}


def test_host_code_stays_at_the_rim():
    """No libraries of the rim, and no printing, below it."""
    offenders = []
    for own, path in _files():
        if own in _HOST_ROOMS:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [name.name for name in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                names = [node.module]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                names = ["print()"] if node.func.id == "print" else []
            else:
                continue
            wrong = [n for n in names if n == "print()" or n.split(".")[0] in _HOST_LIBRARIES]
            offenders += [f"{path.relative_to(_PACKAGE)}: {n}" for n in wrong]
    assert not offenders
