"""The public files of the measured sets: found on disk, or downloaded.

The list ``remote_files.txt`` says where each file is and what it must hold. pooch
downloads and checks; which failures are worth another try is decided here, since pooch
would ask again for a file that does not exist or is not the one published.
"""

import functools
import hashlib
import importlib.metadata
import logging
import sys
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
    files: list[RemoteFile] = []
    section: tuple[str, ...] = ()
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


# -- the files of a set ----------------------------------------------------------------


@dataclass(frozen=True)
class Access:
    """Where to look for files and how to download them: the loaders' common options."""

    data_home: str | PathLike | None = None
    download_if_missing: bool = True
    n_retries: int = 3
    delay: float = 1.0


@dataclass(frozen=True)
class DataFiles:
    """Public files of one set, found on disk or downloaded when they are asked for."""

    # Those of a set with a `source` are in its folder or nowhere.

    dataset: str
    access: Access
    source: str = ""

    @property
    def folder(self) -> Path:
        """Folder of the set; by default below scikit-learn's data folder."""
        if self.access.data_home is None:
            return Path(get_data_home()) / "sklearn_vbjfa" / self.dataset
        return Path(self.access.data_home).expanduser() / self.dataset

    def find(
        self, wanted: Callable[[str], bool] = lambda path: not _is_description(path)
    ) -> dict[str, Path]:
        """Local file of each wanted path in the repository, by default all data."""
        # Paths of a set with a `source` are those below its folder.
        if self.source:
            return self._on_disk(wanted)
        found = {}
        for remote in remote_files(self.dataset):
            if wanted(remote.path):
                local = find_file(remote, self.folder)
                found[remote.path] = self._download(remote) if local is None else local
        return found

    def published_urdf(self) -> str | None:
        """URDF or MJCF published with the data; None if absent and not downloaded."""
        try:
            (local,) = self.find(_is_description).values()
        except FileNotFoundError:
            return None
        return str(local.resolve())

    def _on_disk(self, wanted: Callable[[str], bool]) -> dict[str, Path]:
        """Local file of each wanted path below the folder of the set, sorted."""
        files = (x for x in sorted(self.folder.rglob("*")) if x.is_file())
        below = {local.relative_to(self.folder).as_posix(): local for local in files}
        found = {path: local for path, local in below.items() if wanted(path)}
        if not found:
            there = f"only {', '.join(below)}" if below else "no files"
            raise FileNotFoundError(
                f"{self.dataset}: {there} in {self.folder}; put the files of the set "
                f"there, which come from {self.source} and are not downloaded."
            )
        return found

    def _download(self, remote: RemoteFile) -> Path:
        """Download one file to its place in the folder of the set."""
        local = self.folder / remote.path
        if not self.access.download_if_missing:
            raise FileNotFoundError(
                f"{self.dataset}: no {remote.path} in {self.folder} and "
                f"download_if_missing=False; allow the download, or put the file "
                f"from {remote.address} at {local}."
            )
        download_file(remote, local, self.access)
        return local


def collected_urdf(path: str) -> Callable[[DataFiles], str | None]:
    """Find a URDF in the folder of a set, else by its path in example-robot-data."""

    def find(files):
        # The collection is found without importing it, as that loads Pinocchio.
        try:
            collection = importlib.metadata.files("example-robot-data") or []
        except importlib.metadata.PackageNotFoundError:
            collection = []
        candidates = [
            files.folder / Path(path).name,
            *(Path(x.locate()) for x in collection if str(x).endswith(path)),
            Path(sys.prefix, "share/example-robot-data/robots", path),
        ]
        there = (str(x.resolve()) for x in candidates if x.is_file())
        return next(there, None)

    return find


def _is_description(path: str) -> bool:
    """Whether a file is the description of a robot, and holds no data."""
    return path.endswith((".urdf", ".xml"))


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


# -- transport -------------------------------------------------------------------------


def download_file(remote: RemoteFile, target: Path, access: Access) -> None:
    """Download one file; it appears at `target` whole and checked, or not at all."""
    # Only a download pays for the import of an HTTP client.
    import pooch

    n_retries = access.n_retries
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
        _LOGGER.info("Attempt %d failed, next in %g s", attempt + 1, access.delay)
        time.sleep(access.delay)


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
