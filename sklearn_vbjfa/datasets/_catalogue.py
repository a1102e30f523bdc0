"""What a measured set is, how it is evaluated, and the public loader made of it."""

import functools
import inspect
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.datasets._download import Access, DataFiles, source_address
from sklearn_vbjfa.recording import Log, Recording, join, median_period


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """How one recording is evaluated."""

    # Taken from what is published about the sets and their quick fits, not tuned on the
    # held-out part.

    load: Callable | None = None  # loader; takes `data_home` (but for the demo)
    # names of the recordings to fit and to test; empty for a split in time
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    # with a split in time: the first share of every recording of `train`, by default of
    # all, is fitted, and the rest of those is tested
    share: float = 0.7
    cutoff: float | str = "auto"  # low-pass [Hz]
    # speed [rad/s or m/s] at or below which a joint counts as standing still
    standstill: float | str = "auto"
    friction: tuple[str, ...] = ("viscous", "coulomb", "offset", "rotor_inertia")

    def split(self, recording):
        """Return the row numbers of the training and of the held-out part."""
        names = np.array(recording.group_names)[recording.groups]
        if self.test:
            fitted = np.isin(names, self.train)
            return np.flatnonzero(fitted), np.flatnonzero(np.isin(names, self.test))
        train, test = [], []
        for label, name in enumerate(recording.group_names):
            if self.train and name not in self.train:
                continue
            rows = np.flatnonzero(recording.groups == label)
            border = int(self.share * rows.size)
            train.append(rows[:border])
            test.append(rows[border:])
        return np.concatenate(train), np.concatenate(test)

    def describe(self, recording):
        """Say in words what was fitted and what was tested."""
        if self.test:
            return f"fitted: {', '.join(self.train)}; held out: {', '.join(self.test)}"
        names = ", ".join(self.train or recording.group_names)
        return f"first {100 * self.share:.0f} % of {names} fitted, the rest held out"


@dataclass(frozen=True, kw_only=True)
class DataSet:
    """One measured set."""

    # takes the `DataFiles` and the loader's own options, returns logs
    read: Callable[..., list[Log]]
    joint_names: tuple[str, ...]  # as in the description of the robot
    # one entry alone holds for every joint
    position_units: tuple[str, ...] = ("rad",)
    torque_units: tuple[str, ...] = ("N m",)
    dt: float | None = None  # sample period [s]; None is the median step of the stamps
    irregular: bool = False  # whether stamps vary: the loader then has `resample`
    # whether the logger wrote readings twice, which are then dropped
    drop_repeated: bool = False
    # finds the description among or for the files; None if the model is built without
    urdf: Callable[[DataFiles], str | None] = lambda files: None
    # folder that files are found in and not downloaded to; they have no lines in
    # ``remote_files.txt``
    source: str = ""
    # fields of the `Recording`
    licence: str
    citation: str
    description: str | dict[str, str]  # the same; of each choice of ``which``
    protocol: Protocol

    def load(
        self, name: str, access: Access, *, resample: bool = True, **options
    ) -> Recording:
        """Load the set under its name, with the options of its reader."""
        files = DataFiles(name, access, self.source)
        logs = self.read(files, **options)
        nv = len(self.joint_names)
        return Recording(
            name=name,
            **join(
                logs,
                dt=self.dt or median_period(logs),
                resample=resample,
                drop_repeated=self.drop_repeated,
            ),
            joint_names=self.joint_names,
            position_units=_one_each(self.position_units, nv),
            torque_units=_one_each(self.torque_units, nv),
            urdf=self.urdf(files),
            source=self.source or source_address(name),
            licence=self.licence,
            citation=self.citation,
            description=_chosen(self.description, options),
        )


def _chosen(said, options):
    """Return what is said of the files that were chosen."""
    return (
        said if isinstance(said, str) else said[options.get("which", next(iter(said)))]
    )


def _one_each(units, nv):
    """Repeat a unit that stands alone for each of the nv joints."""
    return units if len(units) == nv else units * nv


# -- public loaders --------------------------------------------------------------------

# What the documentation of loaders shares, by where it stands: of sets that are
# downloaded, and of those that have a `source`.
_DOWNLOADED = {
    "{access}": """\
data_home : path-like or None, default=None
    Folder that holds, or will hold, the folder ``{name}``; by default
    ``sklearn_vbjfa`` in scikit-learn's data folder.
download_if_missing : bool, default=True
    Whether to download what is absent instead of raising an error.
n_retries : int, default=3
    Further tries after a failure of the network.
delay : float, default=1.0
    Time between two tries [s].""",
    "{raises}": """\
Raises
------
OSError
    If a file is absent and may not or cannot be downloaded, or does not
    hold what was published.""",
}
_FROM_ELSEWHERE = {
    "{access}": """\
data_home : path-like or None, default=None
    Folder that holds the folder ``{name}`` with the files (see Notes); by
    default ``sklearn_vbjfa`` in scikit-learn's data folder.
download_if_missing : bool, default=True
    Without effect: the files are not downloaded.""",
    "{raises}": """\
Raises
------
OSError
    If the files are absent.""",
}
_RESAMPLE = """\
resample : bool, default=True
    If False, samples and stamps are as recorded."""


def measured(
    catalogue: dict[str, DataSet], **entry
) -> Callable[[Callable], Callable[..., Recording]]:
    """Enter a set in a catalogue by the function that reads it; make its loader."""
    # The loader has the options of `Access` in front of those of the set, and the
    # documentation of the function, in which braces stand for what loaders share.

    def make(read):
        name = read.__name__.removeprefix("fetch_")
        made = DataSet(read=read, **entry)
        signature = _signature(made)

        @functools.wraps(read)
        def fetch(**options):
            bound = signature.bind(**options)
            bound.apply_defaults()
            given = bound.arguments
            common = inspect.signature(Access).parameters.keys() & given.keys()
            access = Access(**{key: given.pop(key) for key in common})
            return made.load(name, access, **given)

        del fetch.__wrapped__
        fetch.__signature__ = signature
        fetch.__annotations__ = {
            one.name: one.annotation for one in signature.parameters.values()
        } | {"return": Recording}
        fetch.__doc__ = read.__doc__ and _documented(read.__doc__, name, made)
        protocol = replace(made.protocol, load=fetch)
        catalogue[name] = replace(made, protocol=protocol)
        return fetch

    return make


def _signature(made):
    """Return the signature of a set's loader."""
    common = list(inspect.signature(Access).parameters.values())
    if made.source:
        common = common[:2]  # without what a download needs
    _, *own = inspect.signature(made.read).parameters.values()
    if made.irregular:
        own += [inspect.signature(made.load).parameters["resample"]]
    return inspect.Signature(
        [one.replace(kind=one.KEYWORD_ONLY) for one in (*common, *own)],
        return_annotation=Recording,
    )


def _documented(text, name, made):
    """Fill in what the documentation of a loader leaves to all of them."""
    cited = textwrap.wrap(
        f".. [1] {made.citation}", 76, subsequent_indent="   ", break_on_hyphens=False
    )
    parts = _FROM_ELSEWHERE if made.source else _DOWNLOADED
    parts = parts | {
        "{resample}": _RESAMPLE,
        "{references}": "\n".join(["References", "----------", *cited]),
    }
    for key, part in parts.items():
        text = text.replace(f"    {key}", textwrap.indent(part, "    "))
    return text.replace("{name}", name)
