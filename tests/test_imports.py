"""Who may import whom, and what importing the package loads."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import sklearn_vbjfa

PACKAGE = "sklearn_vbjfa"
ROOT = Path(sklearn_vbjfa.__file__).parent
MODULES = sorted(ROOT.rglob("*.py"))
OPTIONAL = {"pinocchio", "matplotlib", "dask", "distributed"}
OPTIONAL |= {"tqdm", "pandas", "pyarrow", "rosbags", "python_calamine"}


@functools.cache
def tree_of(path):
    """Syntax tree of a module, which every test reads anew."""
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def name_of(path):
    """Dotted name of a module of the package."""
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room_of(module):
    """Room of a dotted name: a folder of the package, or "top"."""
    parts = module.split(".")
    if len(parts) == 1:
        return "top"
    if parts[1] == "__main__":
        return "_cli"
    return parts[1]


@functools.cache
def every_import(path):
    """Find dotted names, with whether they are inside a function, and for types."""
    found = []

    def visit(node, inside, types):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module, *(f"{node.module}.{x.name}" for x in node.names)]
        found.extend((name, inside, types) for name in names)
        inside |= isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        types |= isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for child in ast.iter_child_nodes(node):
            if isinstance(child, (ast.stmt, ast.ExceptHandler)):
                visit(child, inside, types)

    visit(tree_of(path), inside=False, types=False)
    return found


def imports(path, *, inside_functions=True, for_types=True):
    """Every imported dotted name; of ``from a import b`` both a and a.b."""
    return [
        name
        for name, inside, types in every_import(path)
        if (inside_functions or not inside) and (for_types or not types)
    ]


NAMES = set(map(name_of, MODULES))


def offenders(check):
    """Modules of which a check finds something, with what it finds."""
    found = {name_of(path): check(path) for path in MODULES}
    return {name: what for name, what in found.items() if what}


def imports_at_work(path):
    """Return the packages that a module imports, but for its annotations."""
    return {name.split(".")[0] for name in imports(path, for_types=False)}


def rooms_imported(path):
    """Rooms of the package that a module imports, with what it imports of each."""
    # Faces of rooms name for type checkers what they import when it is asked for.
    used, face = {}, path.stem == "__init__"
    for name in imports(path, for_types=not face):
        if name in NAMES:
            used.setdefault(room_of(name), set()).add(name)
    return used


def modules_of(room):
    return [path for path in MODULES if room_of(name_of(path)) == room]


# Each room may import those above it, as "How the package is built" shows them.
ROOMS = """
    _core effects physical regression model recording inspection simulation equations
    robot fit diagnosis design gravity datasets distributed top _cli
""".split()
# Rooms that stay apart although the order would allow it.
APART = {
    "effects": {"_core"},
    "physical": {"_core", "effects"},
    "regression": {"_core"},
    "model": {"_core", "physical"},
    "recording": {"_core", "model"},
    "inspection": {"_core", "model", "recording"},
    "simulation": {"_core", "effects", "physical", "model"},
    "equations": {"_core", "effects", "physical", "model", "recording", "inspection"},
    # Of inspection the name alone, beside read_recording: what is read is looked at.
    "datasets": {"physical", "model", "recording", "inspection"},
}
# The simulators of `datasets` work on the models themselves.
DOORS_TO_PINOCCHIO = {"model", "datasets"}
# scikit-learn's private parts, in one file that is no estimator.
COMPAT = "sklearn_vbjfa.regression._base"


def forbidden_rooms(path):
    """Rooms that a module imports and may not, with what it imports of each."""
    room = room_of(name_of(path))
    allowed = APART.get(room, set(ROOMS[: ROOMS.index(room)])) | {room}
    forbidden = {
        other: names
        for other, names in rooms_imported(path).items()
        if other not in allowed
    }
    if room != "_core":
        # The version and the name of the package itself, inside functions.
        forbidden.pop("top", None)
    return forbidden


def test_rooms_import_one_way():
    assert offenders(forbidden_rooms) == {}


def explaining(path):
    """Return what the search imports of what follows from it."""
    if ".diagnosis.search" not in name_of(path):
        return []
    return [name for name in imports(path) if ".diagnosis.explain" in name]


def test_the_search_knows_nothing_of_what_follows_from_it():
    assert offenders(explaining) == {}


def test_every_room_has_its_place():
    assert {room_of(name_of(path)) for path in MODULES} == set(ROOMS)


def private_names_of(tree):
    """Names with a leading underscore that a module reads of another object."""
    modules = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for alias in node.names
    }
    own = {
        node.name
        for node in ast.walk(tree)
        if isinstance(node, (ast.FunctionDef, ast.ClassDef))
    }
    own |= {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and ast.unparse(node.value) in {"self", "made"}
    }
    return [
        ast.unparse(node)
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr.startswith("_")
        and not node.attr.startswith("__")
        and ast.unparse(node.value) not in {"self", "cls", "super()"} | modules
        and node.attr not in own
    ]


def foreign_names(path):
    """Private names of other objects that a module reads."""
    # scikit-learn's own step of every fit has this name.
    allowed = "_validate_params"
    found = private_names_of(tree_of(path))
    return [name for name in found if not name.endswith(f".{allowed}")]


def test_no_module_reaches_into_another_ones_objects():
    assert offenders(foreign_names) == {}


def misplaced_packages(path):
    """Return the optional packages that a module imports where it may not."""
    roots = {
        name.split(".")[0]
        for name in imports(path, inside_functions=False, for_types=False)
    }
    everywhere = {name.split(".")[0] for name in imports(path)}
    found = roots & OPTIONAL | everywhere & {"matplotlib"}
    if room_of(name_of(path)) not in DOORS_TO_PINOCCHIO:
        found |= imports_at_work(path) & {"pinocchio"}
    return found


def test_optional_packages_only_inside_functions():
    assert offenders(misplaced_packages) == {}


def loaded_by(*statements):
    """Modules that each of the statements loads in one silent process."""
    show = "print(*(sys.modules.keys() - before)); before = set(sys.modules)"
    lines = ["import sys, sklearn.base; before = set(sys.modules)"]
    for statement in statements:
        lines += [statement, show]
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", "\n".join(lines)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return [set(line.split()) for line in result.stdout.splitlines()]


def test_importing_loads_little_more_than_the_linear_models_do():
    # Names of the package are imported when they are asked for; scikit-learn loads
    # pandas where it is installed, and that pyarrow.
    rooms = ", ".join(f"{PACKAGE}.{room}" for room in ("physical", "datasets"))
    (theirs,) = loaded_by("from sklearn.linear_model import *")
    ours, rest = loaded_by(f"from {PACKAGE} import *", f"import {rooms}")
    assert OPTIONAL & (ours | rest) == set()
    assert len(ours) < len(theirs) + 100
    more = {name.split(".")[0] for name in ours} - sys.stdlib_module_names
    more -= {name.split(".")[0] for name in theirs}
    # tabulate takes wcwidth where something else has installed it
    assert more - {"wcwidth"} == {PACKAGE, "clarabel", "tabulate"}
    # Trees and filters are loaded by the fits that need them.
    parts = {".".join(name.split(".")[:2]) for name in ours - theirs}
    assert not [name for name in parts if name.startswith(("sklearn.", "scipy."))]


def test_private_parts_of_sklearn_are_imported_in_one_place():
    found = {}
    for path in MODULES:
        private = [
            name
            for name in imports(path)
            if name.startswith("sklearn.")
            and any(part.startswith("_") for part in name.split("."))
        ]
        if private:
            found[name_of(path)] = private
    assert list(found) == [COMPAT]


def test_core_is_numpy_and_scipy_alone():
    standard = sys.stdlib_module_names
    others = {"_runtime": {"tqdm", "threadpoolctl"}, "_compiler": {"numba"}}
    for path in modules_of("_core"):
        roots = {name.split(".")[0] for name in imports(path)}
        known = {"numpy", "scipy", PACKAGE} | others.get(path.stem, set())
        assert roots - standard <= known, path.name
