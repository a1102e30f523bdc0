"""Fixtures shared by several folders of tests."""

import contextlib
import importlib.util
import os
import pickle
from pathlib import Path

# One BLAS thread per process: workers of pytest-xdist share the processors. BLAS reads
# these variables when NumPy is imported; child processes inherit them.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Progress bars depend on the clock; tests of progress enable them again.
os.environ["TQDM_DISABLE"] = "1"

import pytest  # noqa: E402


@contextlib.contextmanager
def _locked(path):
    """Hold an exclusive lock on a file; do nothing where fcntl is missing."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """Compute an object in one worker and load its pickle in the others."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent

    def load_or_make(name, make):
        path = folder / f"{name}.pickle"
        with _locked(folder / f"{name}.lock"):
            if not path.exists():
                partial = path.with_suffix(".part")
                partial.write_bytes(pickle.dumps(make()))
                partial.replace(path)
            return pickle.loads(path.read_bytes())

    return load_or_make


@pytest.fixture(scope="session", autouse=True)
def _kernels(once):
    """Compile the simulator in one worker; the others load the cached machine code."""
    modules = ("numba", "pinocchio")
    if "PYTEST_XDIST_WORKER" in os.environ and all(
        map(importlib.util.find_spec, modules)
    ):
        once("kernels", _compile)


def _compile():
    from sklearn_vbjfa.effects import Coupling, MaxwellSlip
    from sklearn_vbjfa.simulation import simulate
    from tests.simulation._machines import Arm

    hysteresis = MaxwellSlip(0, (0.02, 0.1), (), ()), [0.3, 0.2]
    coupled = Coupling(1, 0, 1.0), [0.05, 0.1, 0.02]
    for effects in ([], [hysteresis], [coupled]):
        robot = Arm().robot({"viscous": [0.3, 0.1], "coulomb": [1.0, 0.4]}, effects)
        simulate(robot, [[0.0, 0.0]] * 3, [0.4, -0.6], [1.0, -2.0])


@pytest.fixture(scope="session")
def measured_data_home() -> Path:
    """Folder of the measured data sets: `data_home` of the loaders.

    Defaults to ``shared/data`` next to the repository; skips if it does not exist.
    """
    folder = os.environ.get("SKLEARN_VBJFA_DATA")
    if folder:
        assert Path(folder).is_dir(), f"SKLEARN_VBJFA_DATA is not a folder: {folder}"
        return Path(folder)
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not default.is_dir():
        pytest.skip("no measured sets; name their folder in SKLEARN_VBJFA_DATA")
    return default


@pytest.fixture(scope="session")
def simulated():
    """Simulate two recordings of an arm with known parameters."""
    from sklearn_vbjfa.datasets import make_robot_recording

    return make_robot_recording(
        duration=16.0, dt=0.01, frequency=1.0, n_recordings=2, random_state=1
    )


@pytest.fixture(scope="session")
def new_motion(simulated):
    """Simulate another motion of the same arm."""
    from sklearn_vbjfa.datasets import make_robot_recording

    return make_robot_recording(
        duration=8.0,
        dt=0.01,
        frequency=0.9,
        inertial=simulated.inertial,
        friction=simulated.friction,
        random_state=7,
    )


@pytest.fixture(scope="session")
def identified(simulated):
    """Identify the simulated arm with default settings; tests must not modify it."""
    from sklearn_vbjfa import RobotIdentifier

    robot = RobotIdentifier(
        simulated.urdf, dt=simulated.dt, friction=("viscous", "coulomb")
    )
    return robot.fit(simulated.q, simulated.tau, groups=simulated.groups)
