"""Written robots are read back by other programs, at small size."""

import pytest

pytest.importorskip("pinocchio")

import bench_exports as bench

PREFERRED = ("kinova", "baxter")


@pytest.mark.parametrize("name", PREFERRED)
def test_torques_of_both_files(name):
    """Continuous joints, sliding ones and those that mimic others."""
    pytest.importorskip("mujoco")
    found = {
        known: path for known, path in bench.descriptions().items() if name in known
    }
    if not found:
        pytest.skip("example-robot-data is not installed")
    ((known, path),) = found.items()
    row, errors = bench.run(known, path, bench.ROBOTS.index(known), 20)
    assert len(row) == len(bench.HEADERS)
    assert max(errors.values()) < 1e-6
    kinds = {"kinova": ["3", "0", "0"], "baxter": ["0", "4", "2"]}
    assert row[2:5] == kinds[name]


def test_an_error_in_a_file_shows(tmp_path):
    """The comparison sees a body that is a thousandth too heavy."""
    pytest.importorskip("mujoco")
    found = bench.descriptions()
    if not found:
        pytest.skip("example-robot-data is not installed")
    path = next(iter(found.values()))
    robot = bench.draw(path, 0)
    states = bench.states_of(robot, 20, bench.np.random.default_rng(0))
    truth = bench.smooth_and_dry(robot, states)
    robot.bodies[0] *= 1.001
    target = tmp_path / "robot.urdf"
    bench.to_urdf(target, path, robot, bench.min_eigenvalue(robot.bodies))
    read = bench.urdf_torques(target, states, robot.joint_names)
    assert bench.worst(read, truth["rigid"] + truth["viscous"] + truth["dry"]) > 1e-6
