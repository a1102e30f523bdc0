"""Allowed imports between subpackages, and modules loaded by an import."""

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
    """Syntax tree of a module."""
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def name_of(path):
    """Dotted name of a module of the package."""
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room_of(module):
    """Subpackage of a dotted name, or "top"."""
    parts = module.split(".")
    if len(parts) == 1:
        return "top"
    if parts[1] == "__main__":
        return "_cli"
    return parts[1]


@functools.cache
def every_import(path):
    """Return imported names; whether each is inside a function, and for typing only."""
    statements = []

    def visit(node, inside, types):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module, *(f"{node.module}.{x.name}" for x in node.names)]
        statements.extend((name, inside, types) for name in names)
        inside |= isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        types |= isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for child in ast.iter_child_nodes(node):
            if isinstance(child, (ast.stmt, ast.ExceptHandler)):
                visit(child, inside, types)

    visit(tree_of(path), inside=False, types=False)
    return statements


def imports(path, *, inside_functions=True, for_types=True):
    """Return imported dotted names; ``from a import b`` yields a and a.b."""
    return [
        name
        for name, inside, types in every_import(path)
        if (inside_functions or not inside) and (for_types or not types)
    ]


NAMES = set(map(name_of, MODULES))


def offenders(check):
    """Return findings of a check by module, for modules that have any."""
    findings = {name_of(path): check(path) for path in MODULES}
    return {name: finding for name, finding in findings.items() if finding}


def imports_at_work(path):
    """Return the packages that a module imports, except for annotations."""
    return {name.split(".")[0] for name in imports(path, for_types=False)}


def rooms_imported(path):
    """Names that a module imports, by subpackage."""
    # __init__ files import lazily and repeat these imports for type checkers.
    used, is_package = {}, path.stem == "__init__"
    for name in imports(path, for_types=not is_package):
        if name in NAMES:
            used.setdefault(room_of(name), set()).add(name)
    return used


def modules_of(room):
    return [path for path in MODULES if room_of(name_of(path)) == room]


# Each subpackage may import those before it; see docs/contributing.rst.
ROOMS = """
    _core effects physical regression model recording inspection simulation equations
    robot fit diagnosis design gravity datasets distributed top _cli
""".split()
# Subpackages that may import less than the order allows.
RESTRICTED = {
    "effects": {"_core"},
    "physical": {"_core", "effects"},
    "regression": {"_core"},
    "model": {"_core", "physical"},
    "recording": {"_core", "model"},
    "inspection": {"_core", "model", "recording"},
    "simulation": {"_core", "effects", "physical", "model"},
    "equations": {"_core", "effects", "physical", "model", "recording", "inspection"},
    # `inspection` because read_recording inspects what it reads.
    "datasets": {"physical", "model", "recording", "inspection"},
}
# The simulators of `datasets` use pinocchio models directly.
PINOCCHIO_USERS = {"model", "datasets"}
# The only module that imports private modules of scikit-learn.
COMPAT = "sklearn_vbjfa.regression._base"


def forbidden_rooms(path):
    """Forbidden imports of a module, by subpackage."""
    room = room_of(name_of(path))
    allowed = RESTRICTED.get(room, set(ROOMS[: ROOMS.index(room)])) | {room}
    forbidden = {
        other: names
        for other, names in rooms_imported(path).items()
        if other not in allowed
    }
    if room != "_core":
        # Functions import the version and the package name from the top level.
        forbidden.pop("top", None)
    return forbidden


def test_subpackages_import_in_one_direction():
    assert offenders(forbidden_rooms) == {}


def explain_imports(path):
    """Return what a module of the search imports from `explain`."""
    if ".diagnosis.search" not in name_of(path):
        return []
    return [name for name in imports(path) if ".diagnosis.explain" in name]


def test_search_does_not_import_explain():
    assert offenders(explain_imports) == {}


def test_every_subpackage_is_listed():
    assert {room_of(name_of(path)) for path in MODULES} == set(ROOMS)


def private_attributes(tree):
    """Private attributes that a module reads from objects of other modules."""
    modules = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for alias in node.names
    }
    defined = {
        node.name
        for node in ast.walk(tree)
        if isinstance(node, (ast.FunctionDef, ast.ClassDef))
    }
    defined |= {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and ast.unparse(node.value) == "self"
    }
    return [
        ast.unparse(node)
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr.startswith("_")
        and not node.attr.startswith("__")
        and ast.unparse(node.value) not in {"self", "cls", "super()"} | modules
        and node.attr not in defined
    ]


def foreign_private_attributes(path):
    """Private attributes that a module reads, except scikit-learn's own."""
    # Every fit of scikit-learn calls this method.
    allowed = "_validate_params"
    names = private_attributes(tree_of(path))
    return [name for name in names if not name.endswith(f".{allowed}")]


def test_no_module_reads_private_attributes_of_others():
    assert offenders(foreign_private_attributes) == {}


def misplaced_packages(path):
    """Return the optional packages that a module must not import at that place."""
    roots = {
        name.split(".")[0]
        for name in imports(path, inside_functions=False, for_types=False)
    }
    everywhere = {name.split(".")[0] for name in imports(path)}
    misplaced = roots & OPTIONAL | everywhere & {"matplotlib"}
    if room_of(name_of(path)) not in PINOCCHIO_USERS:
        misplaced |= imports_at_work(path) & {"pinocchio"}
    return misplaced


def test_optional_packages_only_inside_functions():
    assert offenders(misplaced_packages) == {}


def loaded_by(*statements):
    """Modules loaded by each statement, in one process without warnings."""
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


def test_import_loads_few_modules():
    # The package imports its names lazily. scikit-learn loads pandas if it is
    # installed, which loads pyarrow.
    rooms = ", ".join(f"{PACKAGE}.{room}" for room in ("physical", "datasets"))
    (theirs,) = loaded_by("from sklearn.linear_model import *")
    ours, rest = loaded_by(f"from {PACKAGE} import *", f"import {rooms}")
    assert OPTIONAL & (ours | rest) == set()
    assert len(ours) < len(theirs) + 100
    more = {name.split(".")[0] for name in ours} - sys.stdlib_module_names
    more -= {name.split(".")[0] for name in theirs}
    # tabulate imports wcwidth if it is installed.
    assert more - {"wcwidth"} == {PACKAGE, "clarabel", "tabulate"}
    # Trees and filters are loaded by the first fit that needs them.
    parts = {".".join(name.split(".")[:2]) for name in ours - theirs}
    assert not [name for name in parts if name.startswith(("sklearn.", "scipy."))]


def test_private_sklearn_modules_are_imported_in_one_place():
    users = {}
    for path in MODULES:
        private = [
            name
            for name in imports(path)
            if name.startswith("sklearn.")
            and any(part.startswith("_") for part in name.split("."))
        ]
        if private:
            users[name_of(path)] = private
    assert list(users) == [COMPAT]


def test_core_imports_only_numpy_and_scipy():
    standard = sys.stdlib_module_names
    others = {"_runtime": {"tqdm", "threadpoolctl"}, "_compiler": {"numba"}}
    for path in modules_of("_core"):
        roots = {name.split(".")[0] for name in imports(path)}
        allowed = {"numpy", "scipy", PACKAGE} | others.get(path.stem, set())
        assert roots - standard <= allowed, path.name
