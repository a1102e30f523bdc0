"""Content and installation of the wheel and the source distribution."""

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
from tests.test_docs import PUBLIC_MODULES

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
    """Lowest version by package, from requirements such as "pin>=3; python_version"."""
    pairs = (re.match(r"([\w.-]+)(?:\[\w+\])? ?>=([\w.]+)", name) for name in names)
    return dict(pair.groups() for pair in pairs)


def test_conda_recipe_matches_pip_requirements():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    recipe = (ROOT / ".ci" / "conda" / "recipe.yaml").read_text("utf-8")
    listed = re.findall(r"^    - (\S+ >=[\d.]+)$", recipe, flags=re.M)
    required = requirements(project["dependencies"])
    extra = requirements(project["optional-dependencies"]["robot"])
    # conda-forge names the package pinocchio, PyPI pin.
    assert requirements(listed) == required | {"pinocchio": extra["pin"]}
    assert f"version: {sklearn_vbjfa.__version__}\n" in recipe
    (script,) = project["scripts"].items()
    assert f"- {' = '.join(script)}\n" in recipe


def test_release_check_finds_version_mismatches():
    if shutil.which("bash") is None:
        pytest.skip("the script needs bash")
    process = subprocess.run(
        ["bash", ".ci/check-version", "v99.1.0"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 1
    for name in ("sklearn_vbjfa/__init__.py", "CHANGELOG.md", "CITATION.cff"):
        assert name in process.stderr
    assert "recipe.yaml" in process.stderr


def test_release_links_are_absolute(tmp_path):
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
    assert "https://a.github.io/b/v0.2.0/evidence.html" in links
    assert "https://doi.org/10.1016/j.neunet.2010.08.011" in links
    project = tomllib.loads((tmp_path / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["urls"]["Source"] == address
    assert project["urls"]["Documentation"] == "https://a.github.io/b/v0.2.0"
    assert project["name"] == "sklearn-vbjfa"


def test_windows_check_runs_without_pinocchio(tmp_path):
    workflow = (ROOT / ".github" / "workflows" / "release.yml").read_text("utf-8")
    (code,) = re.findall(r"<<'CODE'\n(.*?) *CODE", workflow, flags=re.DOTALL)
    absent = "import sys\nsys.modules['pinocchio'] = None\n"
    effects = "from sklearn_vbjfa._cli import main\nassert main(['effects']) == 0\n"
    code = absent + textwrap.dedent(code) + effects
    run("-c", code, cwd=tmp_path, PYTHONPATH=str(ROOT))


def run(*arguments, cwd, **environment):
    process = subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


def build(kind, source, target):
    """Build with the hooks of the build backend, as installers do."""
    call = f"import hatchling.build as b; b.build_{kind}({str(target)!r})"
    run("-c", call, cwd=source)
    return next(target.iterdir())


def install_and_use(wheel, folder):
    run(
        *("-m", "pip", "install", "-q", "--no-deps", "--no-index"),
        *("--target", str(folder), str(wheel)),
        cwd=folder,
    )
    run("-c", USE, cwd=folder, PYTHONPATH=str(folder))


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    return build("sdist", ROOT, tmp_path_factory.mktemp("sdist"))


@pytest.mark.slow
def test_wheel_contains_the_package_and_installs(tmp_path):
    wheel = build("wheel", ROOT, tmp_path)
    names = zipfile.ZipFile(wheel).namelist()
    files = {
        path.relative_to(ROOT).as_posix()
        for ending in ("py", "j2")
        for path in (ROOT / "sklearn_vbjfa").rglob(f"*.{ending}")
    }
    assert files <= set(names)
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


@pytest.mark.slow
def test_every_public_name_has_a_type(tmp_path):
    names = [(m.__name__, name) for m in PUBLIC_MODULES for name in m.__all__]
    lines = [
        f"from {module} import {name} as n{k}" for k, (module, name) in enumerate(names)
    ]
    lines += [f"reveal_type(n{k})" for k in range(len(names))]
    lines += [
        "from sklearn_vbjfa.datasets import load_demo_recording, read_recording",
        "reveal_type(load_demo_recording().q)",
        "reveal_type(read_recording('arm.csv').select(0).dt)",
    ]
    (tmp_path / "use.py").write_text("\n".join(lines), encoding="utf-8")
    options = [f"--config-file={ROOT / 'pyproject.toml'}", "--cache-dir"]
    options += [str(tmp_path / "cache"), str(tmp_path / "use.py")]
    output = run("-m", "mypy", *options, cwd=ROOT)
    revealed = [line for line in output.splitlines() if "Revealed type" in line]
    assert len(revealed) == len(names) + 2
    assert [line for line in revealed if line.endswith('"Any"')] == []
