"""Fixtures that several folders of tests share."""

import contextlib
import importlib.util
import os
import pickle
from pathlib import Path

# Workers share the processors: with several threads each, they wait for one another.
# Before NumPy is loaded, as its BLAS reads this once; processes that tests start and
# the workers of pytest-xdist inherit it.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# What long runs show hangs on the clock; tests of it take this back.
os.environ["TQDM_DISABLE"] = "1"

import pytest  # noqa: E402


@contextlib.contextmanager
def _locked(path):
    """Let one process at a time through; without locks of files, all."""
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
    """Make something in one of the workers, and read its pickle in the others."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent

    def made(name, make):
        path = folder / f"{name}.pickle"
        with _locked(folder / f"{name}.lock"):
            if not path.exists():
                whole = path.with_suffix(".part")
                whole.write_bytes(pickle.dumps(make()))
                whole.replace(path)
            return pickle.loads(path.read_bytes())

    return made


@pytest.fixture(scope="session", autouse=True)
def _kernels(once):
    """Have one worker compile the simulator, whose machine code the others read."""
    needed = ("numba", "pinocchio")
    if "PYTEST_XDIST_WORKER" in os.environ and all(
        map(importlib.util.find_spec, needed)
    ):
        once("kernels", _compile)


def _compile():
    from sklearn_vbjfa.effects import Coupling, MaxwellSlip
    from sklearn_vbjfa.simulation import simulate
    from tests.simulation._machines import Arm

    remembered = MaxwellSlip(0, (0.02, 0.1), (), ()), [0.3, 0.2]
    coupled = Coupling(1, 0, 1.0), [0.05, 0.1, 0.02]
    for effects in ([], [remembered], [coupled]):
        robot = Arm().robot({"viscous": [0.3, 0.1], "coulomb": [1.0, 0.4]}, effects)
        simulate(robot, [[0.0, 0.0]] * 3, [0.4, -0.6], [1.0, -2.0])


@pytest.fixture(scope="session")
def measured_data_home() -> Path:
    """Folder of the measured sets, as `data_home` of the loaders expects it.

    Without SKLEARN_VBJFA_DATA ``shared/data`` next to the repository, or a skip.
    """
    named = os.environ.get("SKLEARN_VBJFA_DATA")
    if named:
        assert Path(named).is_dir(), f"SKLEARN_VBJFA_DATA is not a folder: {named}"
        return Path(named)
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not beside.is_dir():
        pytest.skip("no measured sets; name their folder in SKLEARN_VBJFA_DATA")
    return beside


@pytest.fixture(scope="session")
def simulated():
    """Two motions of the made-up arm, and its truth."""
    from sklearn_vbjfa.datasets import make_robot_recording

    return make_robot_recording(
        duration=16.0, dt=0.01, frequency=1.0, n_recordings=2, random_state=1
    )


@pytest.fixture(scope="session")
def new_motion(simulated):
    """Make another motion of the same arm."""
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
    """Identify the made-up arm by default settings; tests must not change it."""
    from sklearn_vbjfa import RobotIdentifier

    robot = RobotIdentifier(
        simulated.urdf, dt=simulated.dt, friction=("viscous", "coulomb")
    )
    return robot.fit(simulated.q, simulated.tau, groups=simulated.groups)
