"""The wheel and the source distribution hold what is needed, and install."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import textwrap
import tomllib
import zipfile
from pathlib import Path

import pytest

import sklearn_vbjfa

ROOT = Path(__file__).resolve().parents[1]
DATA = [
    "sklearn_vbjfa/py.typed",
    "sklearn_vbjfa/datasets/measured.toml",
    "sklearn_vbjfa/datasets/remote_files.txt",
    "sklearn_vbjfa/datasets/robots/demo_arm.urdf",
]
USE = """
import pathlib, sklearn_vbjfa
from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
assert pathlib.Path(sklearn_vbjfa.__file__).is_relative_to(pathlib.Path.cwd())
recording = make_robot_recording(duration=4.0, dt=0.01, random_state=0)
RobotIdentifier(recording.urdf, dt=recording.dt).fit(recording.q, recording.tau)
"""


def requirements(names):
    """Lowest versions by package, of requirements such as "pin>=3; python_version"."""
    pairs = (re.match(r"([\w.-]+)(?:\[\w+\])? ?>=([\w.]+)", name) for name in names)
    return dict(pair.groups() for pair in pairs)


def test_the_conda_recipe_asks_for_what_pip_asks_for():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    recipe = (ROOT / ".ci" / "conda" / "recipe.yaml").read_text("utf-8")
    listed = re.findall(r"^    - (\S+ >=[\d.]+)$", recipe, flags=re.M)
    asked = requirements(project["dependencies"])
    extra = requirements(project["optional-dependencies"]["robot"])
    # conda-forge calls it as its authors do.
    assert requirements(listed) == asked | {"pinocchio": extra["pin"]}
    assert f"version: {sklearn_vbjfa.__version__}\n" in recipe
    (script,) = project["scripts"].items()
    assert f"- {' = '.join(script)}\n" in recipe


LISTS = [
    (["dev"], "dev", ["dev"]),
    (["dev", "v0.2.0"], "v0.2.0", ["v0.2.0", "dev"]),
    (["v0.10.0", "v0.2.0", "dev"], "v0.10.0", ["v0.10.0", "v0.2.0", "dev"]),
    # A candidate is listed, and never the page that one is led to.
    (["v0.2.0", "v0.3.0rc1"], "v0.2.0", ["v0.3.0rc1", "v0.2.0"]),
    (["v0.3.0rc1", "v0.3.0"], "v0.3.0", ["v0.3.0", "v0.3.0rc1"]),
]


@pytest.mark.parametrize(("folders", "led_to", "order"), LISTS)
def test_versions_of_the_pages_are_listed_newest_first(
    folders, led_to, order, tmp_path
):
    for name in (*folders, ".git", "unrelated"):
        (tmp_path / name).mkdir()
    script = str(ROOT / ".ci" / "docs_versions.py")
    run(script, str(tmp_path), "https://pages.example/arm/", cwd=tmp_path)
    found = json.loads((tmp_path / "switcher.json").read_text("utf-8"))
    assert [one["version"] for one in found] == order
    assert [one["url"] for one in found] == [
        f"https://pages.example/arm/{name}/" for name in order
    ]
    assert f"url={led_to}/" in (tmp_path / "index.html").read_text("utf-8")


def test_a_release_names_one_version_everywhere():
    if shutil.which("bash") is None:
        pytest.skip("the script needs bash")
    done = subprocess.run(
        ["bash", ".ci/check-version", "v99.1.0"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    for name in ("sklearn_vbjfa/__init__.py", "CHANGELOG.md", "CITATION.cff"):
        assert name in done.stderr
    assert "recipe.yaml" in done.stderr


def test_links_of_a_release_are_absolute(tmp_path):
    for name in ("README.md", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    script, address = (
        str(ROOT / ".ci" / "release_links.py"),
        "https://forge.example/a/b",
    )
    run(script, address, "v0.2.0", cwd=tmp_path)
    readme = (tmp_path / "README.md").read_text("utf-8")
    links = re.findall(r"\]\(([^)]+)\)", readme)
    assert all(link.startswith("https://") for link in links)
    assert f"{address}/raw/v0.2.0/docs/images/residual.png" in links
    assert f"{address}/blob/v0.2.0/docs/evidence.rst" in links
    assert "https://doi.org/10.1016/j.neunet.2010.08.011" in links
    project = tomllib.loads((tmp_path / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["urls"]["Source"] == address
    assert project["name"] == "sklearn-vbjfa"


def test_what_is_tried_on_windows_runs_without_a_robot(tmp_path):
    flow = (ROOT / ".github" / "workflows" / "release.yml").read_text("utf-8")
    (code,) = re.findall(r"<<'CODE'\n(.*?) *CODE", flow, flags=re.DOTALL)
    absent = "import sys\nsys.modules['pinocchio'] = None\n"
    effects = "from sklearn_vbjfa._cli import main\nassert main(['effects']) == 0\n"
    code = absent + textwrap.dedent(code) + effects
    run("-c", code, cwd=tmp_path, PYTHONPATH=str(ROOT))


def run(*arguments, cwd, **environment):
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def build(kind, source, target):
    """Build as installers do, by the hooks of the build backend."""
    call = f"import hatchling.build as b; b.build_{kind}({str(target)!r})"
    run("-c", call, cwd=source)
    return next(target.iterdir())


def install_and_use(wheel, folder):
    pytest.importorskip("pinocchio")
    run(
        *("-m", "pip", "install", "-q", "--no-deps", "--no-index"),
        *("--target", str(folder), str(wheel)),
        cwd=folder,
    )
    run("-c", USE, cwd=folder, PYTHONPATH=str(folder))


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    pytest.importorskip("hatchling")
    return build("sdist", ROOT, tmp_path_factory.mktemp("sdist"))


@pytest.mark.slow
def test_wheel_holds_the_package_and_installs(tmp_path):
    pytest.importorskip("hatchling")
    wheel = build("wheel", ROOT, tmp_path)
    names = zipfile.ZipFile(wheel).namelist()
    modules = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "sklearn_vbjfa").rglob("*.py")
    }
    templates = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "sklearn_vbjfa").rglob("*.j2")
    }
    assert templates
    assert modules | templates <= set(names)
    assert set(DATA) <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)
    top = {name.split("/")[0] for name in names}
    assert {name for name in top if not name.endswith(".dist-info")} == {
        "sklearn_vbjfa"
    }
    (tmp_path / "site").mkdir()
    install_and_use(wheel, tmp_path / "site")


@pytest.mark.slow
def test_source_distribution_builds_the_same_wheel(sdist, tmp_path):
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    assert re.fullmatch(r"sklearn_vbjfa-[\w.]+", source.name)
    for name in (*DATA, "README.md", "LICENSE", "tests/test_docs.py", "docs/conf.py"):
        assert (source / name).is_file(), name
    for folder in ("_build", "generated", "auto_examples"):
        assert not (source / "docs" / folder).exists()
    (tmp_path / "wheel").mkdir()
    (tmp_path / "site").mkdir()
    install_and_use(build("wheel", source, tmp_path / "wheel"), tmp_path / "site")
