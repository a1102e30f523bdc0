"""Who may import whom, what importing the package loads, and sizes of modules."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import sklearn_vbjfa

PACKAGE = "sklearn_vbjfa"
ROOT = Path(sklearn_vbjfa.__file__).parent
MODULES = sorted(ROOT.rglob("*.py"))
OPTIONAL = {"pinocchio", "matplotlib", "dask", "distributed"}


def name_of(path):
    """Dotted name of a module of the package."""
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def layer_of(module):
    """Layer of a dotted name: a subpackage, "estimators" or "command line"."""
    parts = module.split(".")
    if len(parts) == 1:
        return "top"
    if parts[1] in {"_cli", "__main__"}:
        return "command line"
    folders = {"physical", "effects", "datasets", "robot", "diagnosis", "distributed"}
    if parts[1] in folders | {"_core"}:
        return parts[1]
    return "estimators"


def is_type_checking(node):
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def imports(path, *, inside_functions=True, for_types=True):
    """Every imported dotted name; of ``from a import b`` both a and a.b."""
    found = []

    def visit(node):
        if isinstance(node, ast.Import):
            found.extend(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.append(node.module)
            found.extend(f"{node.module}.{alias.name}" for alias in node.names)
        is_function = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        if is_function and not inside_functions:
            return
        if is_type_checking(node) and not for_types:
            return
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(path.read_text(encoding="utf-8")))
    return found


def layers_imported(path, **kwargs):
    """Layers of the package that a module imports, with what it imports of each."""
    own = {name_of(other) for other in MODULES}
    used = {}
    for name in imports(path, **kwargs):
        if name in own or (name.startswith(PACKAGE) and name.count(".") == 0):
            used.setdefault(layer_of(name), set()).add(name)
    return used


def modules_of(layer):
    return [path for path in MODULES if layer_of(name_of(path)) == layer]


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_are_absolute(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    relative = [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level > 0
    ]
    assert relative == []


# What each layer may import of the package. "top" is the package itself, which
# imports all estimators.
ALLOWED = {
    "_core": {"_core"},
    "physical": {"_core", "physical"},
    "estimators": {"_core", "estimators"},
    "datasets": {"_core", "physical", "datasets"},
    "effects": {"effects"},
    "robot": {"_core", "physical", "estimators", "effects", "robot"},
    "diagnosis": {"_core", "physical", "effects", "robot", "diagnosis"},
    "distributed": {"_core", "estimators", "datasets", "robot", "distributed"},
    "command line": {
        "top",
        "physical",
        "datasets",
        "estimators",
        "effects",
        "robot",
        "diagnosis",
        "command line",
    },
    "top": {"physical", "estimators", "effects", "robot", "diagnosis"},
}
# scikit-learn's private parts, in one file that is no estimator.
COMPAT = "sklearn_vbjfa._sklearn_compat"
# Building a robot's model and its labels is no estimator either.
MODEL = "sklearn_vbjfa.robot._model"


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_layers_import_one_way(path):
    layer = layer_of(name_of(path))
    forbidden = {}
    for other, names in layers_imported(path).items():
        if other not in ALLOWED[layer] | (
            {"top"} if layer == "command line" else set()
        ):
            forbidden[other] = names
    if layer in {"physical", "datasets"}:
        forbidden.get("estimators", set()).discard(COMPAT)
    if layer == "datasets":
        allowed = {MODEL, "sklearn_vbjfa.robot"}
        forbidden["robot"] = forbidden.get("robot", set()) - allowed
    if layer != "_core":
        # The version and the name of the package itself, inside functions.
        forbidden.pop("top", None)
    assert {k: v for k, v in forbidden.items() if v} == {}


def test_the_walk_sees_what_is_there():
    # The test above would pass on nothing at all, too.
    path = ROOT / "_vbjfa.py"
    assert {"_core", "estimators"} <= set(layers_imported(path))
    assert {"_core", "robot"} <= set(
        layers_imported(ROOT / "robot" / "_joint_torque.py")
    )
    assert all(modules_of(layer) for layer in ALLOWED)


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_optional_packages_only_inside_functions(path):
    roots = {
        name.split(".")[0]
        for name in imports(path, inside_functions=False, for_types=False)
    }
    assert roots.isdisjoint(OPTIONAL)
    everywhere = {name.split(".")[0] for name in imports(path)}
    assert "matplotlib" not in everywhere
    if "pinocchio" in everywhere:
        assert layer_of(name_of(path)) in {"robot", "datasets"}


@pytest.mark.parametrize(
    "module", [PACKAGE, f"{PACKAGE}.physical", f"{PACKAGE}.datasets"]
)
def test_importing_loads_no_optional_package(module):
    code = f"import sys, {module}; print(*({OPTIONAL!r} & sys.modules.keys()))"
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == ""
    assert result.stderr == ""


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_modules_have_telling_names(path):
    assert path.stem.strip("_") not in {"utils", "util", "tools", "common", "helpers"}


@pytest.mark.parametrize(
    "module", [PACKAGE, f"{PACKAGE}.physical", f"{PACKAGE}.datasets"]
)
def test_public_names_exist_once_and_in_order(module):
    loaded = importlib.import_module(module)
    names = loaded.__all__
    assert len(names) > 3
    assert list(names) == sorted(set(names))
    for name in names:
        assert hasattr(loaded, name), name
        assert not name.startswith("_")


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
    for path in modules_of("_core"):
        roots = {name.split(".")[0] for name in imports(path)}
        assert roots - standard <= {"numpy", "scipy", PACKAGE}, path.name
