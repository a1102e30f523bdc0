"""The catalogue: every set has its loader, protocols split recordings that exist."""

import inspect

import numpy as np
import pytest

from sklearn_vbjfa import datasets
from sklearn_vbjfa.datasets import (
    CATALOGUE,
    DataFiles,
    Protocol,
    make_robot_recording,
    measured,
    protocols,
)
from sklearn_vbjfa.recording import Log

pytest.importorskip("pinocchio")


SWING = 0.5 * np.sin(np.arange(30))


MADE_UP = {}


@measured(
    MADE_UP,
    irregular=True,
    joint_names=("hinge",),
    dt=0.01,
    urdf=DataFiles.published_urdf,
    source="https://example.org/swing",
    licence="CC0",
    citation="A. Author, A swing.",
    description="",
    protocol=Protocol(),
)
def fetch_swing(files, size: float = 1.0):
    """Load the swing.

    Parameters
    ----------
    {access}
    {resample}

    {raises}

    {references}
    """
    tables = [np.loadtxt(x, delimiter=",") for x in files.find().values()]
    return [
        Log(name="swing", t=t, q=size * q[:, None], tau=tau[:, None])
        for t, q, tau in (table.T for table in tables)
    ]


ALL = ("viscous", "coulomb", "offset", "rotor_inertia")


def test_every_entry_has_a_public_loader_and_units_that_fit():
    loaders = {name for name in datasets.__all__ if name.startswith("fetch_")}
    assert loaders == {f"fetch_{name}" for name in CATALOGUE}
    for entry in CATALOGUE.values():
        nv = len(entry.joint_names)
        assert len(entry.position_units) in (1, nv)
        assert len(entry.torque_units) in (1, nv)


def test_a_set_becomes_its_loader():
    assert list(MADE_UP) == ["swing"]
    assert MADE_UP["swing"].protocol.load is fetch_swing
    # There is nothing to download again.
    assert str(inspect.signature(fetch_swing)) == (
        "(*, data_home: str | os.PathLike | None = None, download_if_missing: bool = "
        "True, size: float = 1.0, resample: bool = True) -> "
        "sklearn_vbjfa.recording._recording.Recording"
    )
    told = inspect.getdoc(fetch_swing)
    for part in ("``swing``", "not downloaded.\nresample : bool", "[1] A. Author"):
        assert part in told
    assert "{" not in told
    with pytest.raises(TypeError, match="n_retries"):
        fetch_swing(n_retries=1)


@pytest.mark.parametrize("name", CATALOGUE)
def test_documentation_of_a_loader_is_complete(name):
    loader = getattr(datasets, f"fetch_{name}")
    assert "{" not in loader.__doc__.replace("{" + '"', "")
    for parameter in inspect.signature(loader).parameters:
        assert f"    {parameter} : " in loader.__doc__
    assert "References\n    ----" in loader.__doc__


def test_a_protocol_splits_in_time_or_by_recording():
    recording = make_robot_recording(duration=1.0, n_recordings=3, random_state=0)
    in_time = Protocol(share=0.75)
    train, test = in_time.split(recording)
    assert train.size == 450
    np.testing.assert_array_equal(np.sort(np.append(train, test)), np.arange(600))
    for k in range(3):  # what is held out is later than what is fitted
        mine = recording.groups == k
        assert train[mine[train]].max() < test[mine[test]].min()
    some = Protocol(train=("motion_2",), share=0.5)
    train, test = some.split(recording)
    np.testing.assert_array_equal(train, np.arange(200, 300))
    np.testing.assert_array_equal(test, np.arange(300, 400))
    named = Protocol(train=("motion_1", "motion_3"), test=("motion_2",))
    train, test = named.split(recording)
    np.testing.assert_array_equal(np.unique(recording.groups[train]), [0, 2])
    np.testing.assert_array_equal(test, np.arange(200, 400))
    assert named.describe(recording) == (
        "fitted: motion_1, motion_3; held out: motion_2"
    )
    assert some.describe(recording).startswith("first 50 % of motion_2 fitted")


def test_protocols_name_loaders_and_known_friction():
    known = protocols()
    assert next(iter(known)) == "demo"
    assert len(known) == len(CATALOGUE) + 1
    for protocol in known.values():
        assert callable(protocol.load)
        assert set(protocol.friction) <= set(ALL)
        assert not set(protocol.train) & set(protocol.test)


def test_protocols_name_recordings_that_exist(measured_data_home):
    for name, protocol in protocols().items():
        if name == "demo" or not protocol.train:
            continue
        recording = protocol.load(
            data_home=measured_data_home, download_if_missing=False
        )
        assert set(protocol.train + protocol.test) <= set(recording.group_names)
        assert 0 < protocol.split(recording)[0].size < recording.n_samples


def test_a_set_from_elsewhere_is_found_in_its_folder(tmp_path):
    folder = tmp_path / "swing" / "raw"
    folder.mkdir(parents=True)
    table = np.column_stack([0.01 * np.arange(30), SWING, np.zeros(30)])
    np.savetxt(folder / "one.csv", table, delimiter=",")
    recording = fetch_swing(data_home=tmp_path)
    assert recording.group_names == ("swing",)
    np.testing.assert_allclose(recording.q[:, 0], SWING, atol=1e-12)
    assert recording.source == "https://example.org/swing"
    assert recording.urdf is None
    description = folder.parent / "swing.urdf"
    description.write_text("<robot/>")
    recording = fetch_swing(data_home=tmp_path, size=2.0)
    assert recording.urdf == str(description.resolve())
    np.testing.assert_allclose(recording.q[:, 0], 2.0 * SWING, atol=1e-12)


@pytest.mark.parametrize("there", ["no files", "only swing.urdf"])
def test_a_set_from_elsewhere_says_where_its_files_go(there, tmp_path):
    if there != "no files":
        (tmp_path / "swing").mkdir()
        (tmp_path / "swing" / "swing.urdf").write_text("<robot/>")
    with pytest.raises(FileNotFoundError) as info:
        fetch_swing(data_home=tmp_path, download_if_missing=True)
    assert str(info.value) == (
        f"swing: {there} in {tmp_path / 'swing'}; put the files of the set there, "
        "which come from https://example.org/swing and are not downloaded."
    )
