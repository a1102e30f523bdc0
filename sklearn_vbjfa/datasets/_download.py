"""Find the public files of the measured sets, or download them."""

import functools
import hashlib
import logging
import time
from collections import Counter
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from os import PathLike
from pathlib import Path
from urllib.parse import quote

from sklearn.datasets import get_data_home

_LOGGER = logging.getLogger(__name__)
_BASE_ADDRESS = "https://raw.githubusercontent.com"
_TIMEOUT = 30.0  # [s] without a byte


@dataclass(frozen=True, kw_only=True)
class RemoteFile:
    """One public file: where it is and what it must hold."""

    dataset: str
    repository: str
    commit: str
    path: str
    size: int
    sha256: str

    @property
    def address(self) -> str:
        """Address of the raw file at its commit."""
        return (
            f"{_BASE_ADDRESS}/{quote(f'{self.repository}/{self.commit}/{self.path}')}"
        )


@functools.cache
def remote_files(dataset: str) -> tuple[RemoteFile, ...]:
    """Public files of one set, in the order of the list."""
    package = resources.files("sklearn_vbjfa.datasets")
    files, section = [], ()
    for line in package.joinpath("remote_files.txt").read_text("utf-8").splitlines():
        if line.startswith("["):
            section = tuple(line.replace("[", "").replace("]", "").split())
        elif line and not line.startswith("#") and section[0] == dataset:
            sha256, size, path = line.split(maxsplit=2)
            files.append(
                RemoteFile(
                    dataset=dataset,
                    repository=section[1],
                    commit=section[2],
                    path=path,
                    size=int(size),
                    sha256=sha256,
                )
            )
    return tuple(files)


def source_address(dataset: str) -> str:
    """Address of the repository of a set at the commit used."""
    first = remote_files(dataset)[0]
    return f"https://github.com/{first.repository}/tree/{first.commit}"


def dataset_folder(dataset: str, data_home: str | PathLike | None) -> Path:
    """Folder of one set; by default below scikit-learn's data folder."""
    if data_home is None:
        return Path(get_data_home()) / "sklearn_vbjfa" / dataset
    return Path(data_home).expanduser() / dataset


def fetch_files(
    dataset: str,
    *,
    data_home: str | PathLike | None,
    download_if_missing: bool,
    n_retries: int,
    delay: float,
    wanted: Callable[[str], bool] = lambda path: True,
) -> dict[str, Path]:
    """Find or download the files of a set whose path is wanted.

    Returns the local file of each path in the repository.
    """
    folder = dataset_folder(dataset, data_home)
    found = {}
    for remote in remote_files(dataset):
        if not wanted(remote.path):
            continue
        local = find_file(remote, folder)
        if local is None:
            local = folder / remote.path
            if not download_if_missing:
                raise FileNotFoundError(
                    f"{dataset}: no {remote.path} in {folder} and "
                    f"download_if_missing=False; allow the download, or put the file "
                    f"from {remote.address} at {local}."
                )
            download_file(remote, local, n_retries=n_retries, delay=delay)
        found[remote.path] = local
    return found


def fetch_description(dataset: str, **access) -> str | None:
    """URDF published with the data; None if absent and not to be downloaded."""
    try:
        files = fetch_files(
            dataset, **access, wanted=lambda path: path.endswith(".urdf")
        )
    except FileNotFoundError:
        return None
    (local,) = files.values()
    return str(local.resolve())


def find_file(remote: RemoteFile, folder: Path) -> Path | None:
    """Look for a file in the folder of its set and check what it holds."""
    names = Counter(Path(x.path).name for x in remote_files(remote.dataset))
    name = Path(remote.path).name
    candidates = [folder / remote.path, folder / "original" / remote.path]
    if names[name] == 1:
        candidates += [folder / "original" / name, folder / name]
    for candidate in candidates:
        if candidate.is_file():
            _check_sha256(remote, candidate)
            return candidate
    return None


def _check_sha256(remote: RemoteFile, local: Path) -> None:
    """Refuse a local file that does not hold what was published."""
    content = local.read_bytes()
    sha256 = hashlib.sha256(content).hexdigest()
    if sha256 != remote.sha256:
        raise OSError(
            f"{local} is not the file that was published: expected SHA-256 "
            f"{remote.sha256} ({remote.size} bytes), got {sha256} ({len(content)} "
            "bytes); delete it to have it downloaded again."
        )


def download_file(
    remote: RemoteFile, target: Path, *, n_retries: int, delay: float
) -> None:
    """Download one file; it appears at `target` whole and checked, or not at all."""
    # Only a download pays for the import of an HTTP client.
    import pooch

    if n_retries < 0:
        raise ValueError(f"n_retries must be 0 or more, got {n_retries}.")
    target.parent.mkdir(parents=True, exist_ok=True)
    _LOGGER.info("Downloading %s (%d bytes)", remote.address, remote.size)
    for attempt in range(n_retries + 1):
        try:
            with _quiet(pooch.get_logger()):
                pooch.retrieve(
                    remote.address,
                    known_hash=f"sha256:{remote.sha256}",
                    fname=target.name,
                    path=target.parent,
                    downloader=pooch.HTTPDownloader(timeout=_TIMEOUT),
                )
            return
        except OSError as error:
            if attempt == n_retries or _is_final(error):
                raise OSError(
                    f"Cannot download {remote.address} ({error}); without a network, "
                    f"put the file at {target}."
                ) from error
        except ValueError as error:
            # Raised by pooch for a wrong checksum; a second try would not differ.
            raise OSError(
                f"{remote.address} does not hold what was published: expected "
                f"{remote.size} bytes with SHA-256 {remote.sha256}; nothing was kept. "
                f"Try again later, or put the right file at {target}. ({error})"
            ) from error
        _LOGGER.info("Attempt %d failed, next in %g s", attempt + 1, delay)
        time.sleep(delay)


def _is_final(error: OSError) -> bool:
    """Tell a refusal such as 404 from a failure that may pass."""
    response = getattr(error, "response", None)
    if response is None:
        return False
    too_many_requests = response.status_code == 429
    return response.status_code < 500 and not too_many_requests


@contextmanager
def _quiet(logger: logging.Logger):
    """Keep a logger from announcing each download on the terminal."""
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)
