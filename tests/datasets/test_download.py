"""Transport, with a server on this machine instead of the public one."""

import hashlib
import logging

import pytest

from sklearn_vbjfa.datasets import _download

CONTENT = b"t,q\n0,1\n" * 500


@pytest.fixture
def declare(monkeypatch):
    """Declare one public file of a set called "bench"."""

    def replace_list(path="my logs/10s A/log.csv", content=CONTENT):
        remote = _download.RemoteFile(
            dataset="bench",
            repository="owner/name",
            commit="c0ffee",
            path=path,
            size=len(content),
            sha256=hashlib.sha256(content).hexdigest(),
        )
        monkeypatch.setattr(_download, "remote_files", lambda dataset: (remote,))
        return remote

    return replace_list


@pytest.fixture
def fetch(tmp_path):
    def call(**options):
        options = {"n_retries": 0, "delay": 0.0, **options}
        access = _download.Access(data_home=tmp_path, **options)
        return _download.DataFiles("bench", access).find()

    return call


def _files_below(folder):
    return [path for path in folder.rglob("*") if path.is_file()]


def test_file_arrives_and_is_asked_for_once(serve, declare, fetch, tmp_path, capfd):
    remote = declare()
    requests = serve({f"owner/name/c0ffee/{remote.path}": (200, CONTENT, len(CONTENT))})
    (local,) = fetch().values()
    assert local == tmp_path / "bench" / remote.path
    assert local.read_bytes() == CONTENT
    assert fetch() == {remote.path: local}
    assert fetch(download_if_missing=False) == {remote.path: local}
    assert requests == ["/owner/name/c0ffee/my%20logs/10s%20A/log.csv"]
    assert _files_below(tmp_path) == [local]
    assert capfd.readouterr() == ("", "")


def test_download_is_logged(serve, declare, fetch, caplog):
    remote = declare()
    serve({f"owner/name/c0ffee/{remote.path}": (200, CONTENT, len(CONTENT))})
    with caplog.at_level(logging.INFO, logger="sklearn_vbjfa"):
        fetch()
    assert f"Downloading {remote.address} (4000 bytes)" in caplog.text


def test_wrong_content_is_refused_and_not_kept(serve, declare, fetch, tmp_path):
    remote = declare()
    short = CONTENT[:-8]
    requests = serve({f"owner/name/c0ffee/{remote.path}": (200, short, len(short))})
    with pytest.raises(OSError, match=f"expected 4000 bytes .*{remote.sha256}") as info:
        fetch(n_retries=3)
    assert hashlib.sha256(short).hexdigest() in str(info.value)
    assert "\n" not in str(info.value)
    assert len(requests) == 1
    assert _files_below(tmp_path) == []


def test_broken_transfer_is_tried_again_and_leaves_nothing(
    serve, declare, fetch, tmp_path
):
    remote = declare()
    requests = serve(
        {f"owner/name/c0ffee/{remote.path}": (200, CONTENT[:100], len(CONTENT))}
    )
    with pytest.raises(OSError, match=f"Cannot download {remote.address}"):
        fetch(n_retries=2)
    assert len(requests) == 3
    assert _files_below(tmp_path) == []


@pytest.mark.parametrize(("status", "n_requests"), [(404, 1), (429, 3), (503, 3)])
def test_status_decides_whether_to_try_again(
    serve, declare, fetch, tmp_path, status, n_requests
):
    remote = declare()
    requests = serve({f"owner/name/c0ffee/{remote.path}": (status, b"", 0)})
    with pytest.raises(OSError, match=f"{status}.*without a network, put the file at"):
        fetch(n_retries=2)
    assert len(requests) == n_requests
    assert _files_below(tmp_path) == []


def test_no_network_names_address_and_place(declare, fetch, tmp_path, monkeypatch):
    remote = declare()
    # Port 9 (discard) is closed on any machine that runs tests.
    monkeypatch.setattr(_download, "_BASE_ADDRESS", "http://127.0.0.1:9")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with pytest.raises(OSError, match="Cannot download") as info:
        fetch()
    assert remote.address in str(info.value)
    assert str(tmp_path / "bench" / remote.path) in str(info.value)
    assert "\n" not in str(info.value)


def test_missing_file_without_download(declare, fetch, tmp_path):
    remote = declare()
    with pytest.raises(FileNotFoundError, match="download_if_missing=False") as info:
        fetch(download_if_missing=False)
    assert remote.address in str(info.value)
    assert str(tmp_path / "bench" / remote.path) in str(info.value)
    assert "\n" not in str(info.value)


def test_negative_retries_are_refused(declare, fetch):
    declare()
    with pytest.raises(ValueError, match="n_retries must be 0 or more, got -1"):
        fetch(n_retries=-1)


@pytest.mark.parametrize(
    "place",
    ["my logs/10s A/log.csv", "original/my logs/10s A/log.csv"]
    + ["original/log.csv", "log.csv"],
)
def test_local_places(declare, fetch, tmp_path, place):
    remote = declare()
    local = tmp_path / "bench" / place
    local.parent.mkdir(parents=True)
    local.write_bytes(CONTENT)
    assert fetch(download_if_missing=False) == {remote.path: local}


def test_changed_local_file_is_refused(declare, fetch, tmp_path):
    remote = declare()
    local = tmp_path / "bench" / "log.csv"
    local.parent.mkdir()
    local.write_bytes(b"edited")
    with pytest.raises(OSError, match=f"expected SHA-256 {remote.sha256}.*delete it"):
        fetch()


def test_default_home_is_that_of_scikit_learn(monkeypatch, tmp_path):
    monkeypatch.setenv("SCIKIT_LEARN_DATA", str(tmp_path))
    files = _download.DataFiles("emps", _download.Access())
    assert files.folder == tmp_path / "sklearn_vbjfa" / "emps"


def test_list_of_public_files_is_well_formed():
    counts = {
        "bam_xl330": 12,
        "dfki_double_pendulum": 10,
        "emps": 2,
        "franka_panda": 4,
        "kuka_kr300": 2,
        "kuka_lbr_med7": 2,
        "staubli_tx40": 3,
        "tflex_1dof": 1,
        "tiago": 3,
        "ur5": 64,
    }
    for dataset, count in counts.items():
        files = _download.remote_files(dataset)
        assert len({x.path for x in files}) == len(files) == count
        for x in files:
            assert (len(x.commit), len(x.sha256)) == (40, 64)
            assert x.size > 0
            assert x.repository.count("/") == 1
    assert _download.remote_files("kuka_kr300")[0].address == (
        "https://raw.githubusercontent.com/JonasWeigand/Robot_Identification/"
        "9e403c07d9dadbb391a9f3921e8d219f714636a8/data/recorded_trajectories/"
        "2020-10-21%2010s%20FF%20A%2008ms/data.mat"
    )
