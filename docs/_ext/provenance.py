"""What the tables in ``docs/tables`` were made from: commits, and the code as it was.

Beside ``docs/tables/NAME.rst`` lies ``NAME.json``: the script, the commits, and a
digest of every file of the package that the script enters. Pages compare these with the
files that lie there now, for which no history is needed.

A digest is one of the syntax tree: comments, docstrings and the form of the text do not
count, every name and every constant does.

A script enters a file if it uses a name that is defined there, or if a file that it
enters imports that file, inside of functions too. Names are followed through
``__init__.py`` to where they are defined. This is read from the sources: modules that
are merely loaded would be nearly all of the package for every script, a record of the
calls would slow the times that are measured, and neither would see what runs in other
processes. Of the scripts' helpers that part counts which is used. What a script starts
by a text alone, a program or another script, it lists in ``ENTERS``. Scripts have no
digests: they say what is measured, the package what comes out.
"""

import ast
import functools
import hashlib
import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TABLES = ROOT / "docs" / "tables"
PACKAGE = "sklearn_vbjfa"
# A room below which a script is one of the search for effects.
SEARCH = f"{PACKAGE}/diagnosis/search/"
# Fields of the syntax tree that say how something is written.
_FORM = {"kind", "type_comment", "type_ignores"}
_WITH_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


@functools.cache
def digest(text):
    """Twelve digits that change with the code of a file and not with its form."""
    return hashlib.sha256(_canonical(ast.parse(text)).encode()).hexdigest()[:12]


def _canonical(node):
    """Write a syntax tree out, the same for every version of Python.

    ``ast.dump`` shows empty fields or not, and new ones, depending on the version.
    """
    if isinstance(node, list):
        return f"[{','.join(map(_canonical, node))}]"
    if not isinstance(node, ast.AST):
        return repr(node)
    fields = []
    for name, value in ast.iter_fields(node):
        if name == "body" and isinstance(node, _WITH_DOCSTRING):
            value = value[1:] if _is_docstring(value) else value
        if name not in _FORM and value is not None and value != []:
            fields.append(f"{name}={_canonical(value)}")
    return f"{type(node).__name__}({','.join(fields)})"


def _is_docstring(body):
    """Whether a body begins with a string that nobody uses."""
    first = body[0].value if body and isinstance(body[0], ast.Expr) else None
    return isinstance(first, ast.Constant) and isinstance(first.value, str)


def sources(root=ROOT, folders=(PACKAGE, "tests"), package=None):
    """Texts of the Python files below some folders, by their paths from the root.

    `package` is the folder of the package where it is not that of the root.
    """
    places = {folder: Path(root) / folder for folder in folders}
    if package is not None:
        places[PACKAGE] = Path(package)
    return {
        (folder / path.relative_to(place)).as_posix(): path.read_text(encoding="utf-8")
        for folder, place in ((Path(f), p) for f, p in places.items())
        for path in sorted(place.rglob("*.py"))
    }


def entered(script, texts):
    """Files of the package that a script enters, in order.

    Parameters
    ----------
    script : str
        Path of the script, a key of `texts`.
    texts : dict of str to str
        What `sources` returns.
    """
    if script not in texts:
        raise ValueError(f"there is no script {script}")
    found, left = set(), {(script, None)}
    while left:
        path, name = one = left.pop()
        found.add(one)
        for use in _uses(path, name, texts[path]):
            left |= _places(use, path, texts) - found
    return sorted({path for path, _ in found if path.startswith(f"{PACKAGE}/")})


@dataclass(frozen=True, kw_only=True)
class _Use:
    """An import.

    Attributes
    ----------
    module : str
        Dotted name.
    name : str or None
        What is taken from it.
    local : str
        Its name in the file.
    attributes : frozenset of str or None
        What is asked of it by a dot; None if it is used in another way as well.
    """

    module: str
    name: str | None
    local: str
    attributes: frozenset | None


@dataclass(frozen=True, kw_only=True)
class _Part:
    """A statement of a file: names that it defines and uses, and what it imports."""

    defines: frozenset
    names: frozenset
    uses: tuple


def _is_if(node, name):
    """Whether a statement is ``if`` with a condition that holds a name."""
    return isinstance(node, ast.If) and name in ast.unparse(node.test)


def _is_table(node):
    """Whether a statement says in which modules the names of a face are."""
    targets = node.targets if isinstance(node, ast.Assign) else []
    return [getattr(x, "id", "") for x in targets] == ["_MODULES"]


def _asked(node):
    """Return a and b of ``a.b`` and of ``getattr(a, "b", ...)``; else None."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return node.value.id, node.attr
    if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "getattr":
        of, name, *_ = node.args
        if isinstance(of, ast.Name) and isinstance(name, ast.Constant):
            return of.id, name.value
    return None


@functools.cache
def _parts(text, is_init):
    """Statements of a file, a tuple of `_Part`.

    Imports for annotations alone count in an ``__init__.py``, which tells by them where
    its names are. What a file does only as a script does not count.
    """
    tree = ast.parse(text)
    asked, bare = {}, Counter()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            bare[node.id] += 1
        elif (found := _asked(node)) is not None:
            asked.setdefault(found[0], set()).add(found[1])
            bare[found[0]] -= 1

    def use(module, name, local):
        attributes = None if bare[local] > 0 else frozenset(asked.get(local, ()))
        return _Use(module=module, name=name, local=local, attributes=attributes)

    def uses(node):
        if isinstance(node, ast.Import):
            for alias in node.names:
                local = alias.asname or alias.name.split(".")[0]
                yield use(alias.name, None, local)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                yield use(node.module, alias.name, alias.asname or alias.name)
        elif is_init or not _is_if(node, "TYPE_CHECKING"):
            for child in ast.iter_child_nodes(node):
                yield from uses(child)

    parts = []
    for node in tree.body:
        imported = tuple(uses(node))
        if isinstance(node, ast.Import | ast.ImportFrom):
            for one in imported:
                local = frozenset([one.local])
                parts.append(_Part(defines=local, names=frozenset(), uses=(one,)))
            continue
        if is_init and _is_table(node):
            # What a face imports when it is asked for, see `sklearn_vbjfa._lazily`.
            for module, names in ast.literal_eval(node.value).items():
                for name in names:
                    one = _Use(module=module, name=name, local=name, attributes=None)
                    local = frozenset([name])
                    parts.append(_Part(defines=local, names=frozenset(), uses=(one,)))
            continue
        named = [n for n in ast.walk(node) if isinstance(n, ast.Name)]
        if hasattr(node, "name"):
            defines = {node.name}
        else:
            defines = {n.id for n in named if isinstance(n.ctx, ast.Store)}
            defines |= {one.local for one in imported}
        if defines == {"ENTERS"}:
            for whole in ast.literal_eval(node.value):
                module, _, name = whole.rpartition(".")
                one = _Use(module=module, name=name, local=whole, attributes=None)
                imported += (one,)
            defines = set()
        if _is_if(node, "__name__"):
            defines = {"__main__"}
        names = frozenset(n.id for n in named)
        parts.append(_Part(defines=frozenset(defines), names=names, uses=imported))
    return tuple(parts)


def _uses(path, name, text):
    """Return the imports of a file, or of what one name of it needs."""
    parts = _parts(text, path.endswith("__init__.py"))
    if name is None:
        return [use for part in parts for use in part.uses]
    found, wanted, left = [], {name}, list(parts)
    while True:
        now = [part for part in left if not part.defines or part.defines & wanted]
        if not now:
            return found
        left = [part for part in left if part not in now]
        for part in now:
            found.extend(part.uses)
            wanted |= part.names


def _places(use, path, texts):
    """Where that which is imported is defined, a set of path and name.

    Of files of the package there is no name: they count as a whole.
    """
    if use.name is None:
        whole, module = _file(use.module, path, texts), use.module
    elif use.name.startswith("__") and use.name != "__main__":  # a version is no code
        return set()
    elif use.name == "_lazily":  # nor is what makes a face
        return set()
    else:
        module = f"{use.module}.{use.name}".lstrip(".")
        whole = _file(module, path, texts)
        if whole is None:
            return _defining(use.module, use.name, path, texts)
    if whole is None:
        return set()
    if use.attributes is None or not (
        whole.endswith("__init__.py") or whole.startswith("tests/")
    ):
        return {(whole, None)}
    found = set()
    for name in use.attributes:
        if not name.startswith("__"):
            found |= _defining(module, name, path, texts)
    return found


def _defining(module, name, path, texts):
    """Where a name of a module is defined, followed through its ``__init__.py``."""
    whole = _file(f"{module}.{name}", path, texts)
    if whole is not None:
        return {(whole, None)}
    whole = _file(module, path, texts)
    if whole is None:
        return set()
    if whole.endswith("__init__.py"):
        for part in _parts(texts[whole], True):
            for use in part.uses:
                if use.local == name and use.name is not None:
                    return _defining(use.module, use.name, whole, texts)
    return {(whole, name if whole.startswith("tests/") else None)}


def _file(module, path, texts):
    """File of a dotted name, from the root or from beside a file; None if not ours."""
    plain = module.replace(".", "/")
    for folder in ("", f"{path.rpartition('/')[0]}/"):
        for ending in (".py", "/__init__.py"):
            if f"{folder}{plain}{ending}" in texts:
                return f"{folder}{plain}{ending}"
    return None


def state(commit, texts, files=None):
    """Commit and digests of files, those of the whole package unless given."""
    if files is None:
        files = [path for path in texts if path.startswith(f"{PACKAGE}/")]
    return {
        "commit": commit,
        "files": {path: digest(texts[path]) for path in files if path in texts},
    }


def write(name, script, states, files, *, folder=TABLES, **more):
    """Write what a table was made from to NAME.json.

    Parameters
    ----------
    name : str
        Name of the table.
    script : str
        Path of the script.
    states : list of dict
        What `state` returns, for each commit that a part of the table was made at.
    files : list of str
        What the script enters; of the states no other files are kept.
    folder : str or os.PathLike
        Folder of the tables.
    **more : str
        ``words`` before the commits instead of "made at", and ``of``: what the table
        is of, if that has to be said.
    """
    kept = [
        {
            "commit": one["commit"],
            "files": {k: v for k, v in one["files"].items() if k in files},
        }
        for one in states
    ]
    text = json.dumps({"script": script, **more, "states": kept}, indent=1)
    (Path(folder) / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def read(name, folder=TABLES):
    """Return what was written of a table; ValueError if nothing was."""
    path = Path(folder) / f"{name}.json"
    if not path.exists():
        raise ValueError(
            f"nobody knows what docs/tables/{name}.rst was made from: there is no "
            f"{name}.json beside it. Make the table anew with --write, which adds it"
        )
    return json.loads(path.read_text(encoding="utf-8"))


@dataclass(frozen=True, kw_only=True)
class Age:
    """How a table stands to the code as it is.

    Attributes
    ----------
    made : str
        When it was made, in words: "made at 1a2b3c4".
    files : tuple of str
        Files of the package that it was made with.
    changed : tuple of str
        Those of them that are different now, or gone.
    """

    made: str
    files: tuple
    changed: tuple

    def sentence(self):
        """Return what stands below the table."""
        begin = f"{self.made[0].upper()}{self.made[1:]}"
        n, all_of = len(self.changed), len(self.files)
        if not all_of:
            return f"{begin}; whether the code has changed since is not known."
        if not n:
            return (
                f"{begin}; none of the {all_of} files of the package that its script "
                "enters has changed since."
            )
        verb = "has" if n == 1 else "have"
        return (
            f"{begin}; since then {n} of the {all_of} files of the package that its "
            f"script enters {verb} changed"
        )


def commits_of(states):
    """Name the commits of states."""
    return " and ".join(dict.fromkeys(one["commit"] for one in states))


def made(record):
    """Say when a table was made."""
    words = f"{record.get('words', 'made at')} {commits_of(record['states'])}"
    return f"{words}, {record['of']}" if "of" in record else words


def age(record, texts):
    """Compare what a table was made from with files as they are, an `Age`."""
    states = [one["files"] for one in record["states"]]
    files = sorted(set().union(*states))
    changed = []
    for path in files:
        now = digest(texts[path]) if path in texts else None
        if any(one.get(path) != now for one in states):
            changed.append(path)
    return Age(made=made(record), files=tuple(files), changed=tuple(changed))
