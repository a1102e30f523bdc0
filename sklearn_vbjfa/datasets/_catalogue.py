"""The catalogue of the measured sets: what each is, who reads it, how it is evaluated.

A new set takes a reader, an entry here, its files in ``remote_files.txt`` (or the
`source` of files that are converted, or for another reason not downloaded) and a public
loader that carries its documentation.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa.datasets import _readers
from sklearn_vbjfa.datasets._download import Access, DataFiles, source_address
from sklearn_vbjfa.model import find_description, kr300_description
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

    # reader: takes the `DataFiles` and the loader's own options, returns logs
    read: Callable[..., list[Log]]
    joint_names: tuple[str, ...]  # as in the description of the robot
    # one entry alone holds for every joint
    position_units: tuple[str, ...] = ("rad",)
    torque_units: tuple[str, ...] = ("N m",)
    dt: float | None = None  # sample period [s]; None is the median step of the stamps
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


def load(name: str, access: Access, **options) -> Recording:
    """Load one set of the catalogue; see `DataSet.load`."""
    return CATALOGUE[name].load(name, access, **options)


def _chosen(said, options):
    """Return what is said of the files that were chosen."""
    return (
        said if isinstance(said, str) else said[options.get("which", next(iter(said)))]
    )


def _one_each(units, nv):
    """Repeat a unit that stands alone for each of the nv joints."""
    return units if len(units) == nv else units * nv


def _example_robot_data(files: DataFiles) -> str | None:
    """Find the description in the folder of the set or in example-robot-data."""
    return find_description(files.dataset, files.folder)


_FIGAROH = (
    "D. V. Nguyen, V. Bonnet, S. Maxime, M. Gautier, P. Fernbach, F. "
    'Lamiraux, "FIGAROH: a Python toolbox for dynamic identification and '
    'geometric calibration of robots and humans", Humanoids 2023.'
)

_PENDULUM = "Double pendulum with two AK80-6 drives (ratio 6), design A.0."

CATALOGUE = {
    "emps": DataSet(
        read=_readers.read_emps,
        joint_names=("slide",),
        position_units=("m",),
        torque_units=("N",),
        dt=0.001,
        licence="Apache-2.0 (repository)",
        citation=(
            'A. Janot, M. Gautier, M. Brunot, "Data Set and Reference Models of '
            'EMPS", Workshop on Nonlinear System Identification Benchmarks, 2019.'
        ),
        description=(
            "Horizontal ball-screw slide with a DC motor. Force from the voltage "
            "command of the drive, position from the motor encoder."
        ),
        protocol=Protocol(
            train=("DATA_EMPS",),
            cutoff=60.0,
            friction=("viscous", "coulomb", "offset"),
        ),
    ),
    "ur5": DataSet(
        read=_readers.read_ur5,
        joint_names=(
            "shoulder_pan_joint",
            "shoulder_lift_joint",
            "elbow_joint",
            "wrist_1_joint",
            "wrist_2_joint",
            "wrist_3_joint",
        ),
        dt=_readers.UR5_PERIOD,
        urdf=_example_robot_data,
        licence="Apache-2.0",
        citation=(
            'K. Kufieta, "Force Estimation in Robotic Manipulators: Modeling, '
            'Simulation and Experiments", MSc thesis, NTNU, 2014.'
        ),
        description=(
            "UR5 (CB2) in free motion. Torque is a gain times the motor current; "
            "the gains are not verified. Strong stiction at standstill."
        ),
        protocol=Protocol(
            train=("No6", "No4"), test=("No9", "No8"), cutoff=8.0, standstill=0.03
        ),
    ),
    "staubli_tx40": DataSet(
        read=_readers.read_staubli_tx40,
        joint_names=tuple(f"joint_{i}" for i in range(1, 7)),
        dt=_readers.TX40_PERIOD,
        urdf=DataFiles.published_urdf,
        licence="Apache-2.0",
        citation=_FIGAROH,
        description=(
            "Staubli TX40, one exciting trajectory. Torque from the motor current, "
            "position from the motor encoders, wrist joints 5 and 6 coupled."
        ),
        protocol=Protocol(share=0.72, cutoff=25.0),
    ),
    "kuka_kr300": DataSet(
        read=_readers.read_kuka_kr300,
        joint_names=tuple(f"joint_{i}" for i in range(1, 7)),
        dt=0.004,
        urdf=lambda files: kr300_description(),
        licence="MIT, (c) 2021 Jonas Weigand",
        citation=(
            "J. Weigand, J. Ulmen, A. Janot, M. Ruskowski, robot identification "
            "code and measurements, repository Robot_Identification, 2021."
        ),
        description=(
            "KUKA KR300 R2500 ultra SE with payload. Torque from the motor current, "
            "position from the motors; counterbalance on axis 2, elastic gears."
        ),
        protocol=Protocol(train=("A",), test=("B",), cutoff=12.0, standstill=0.02),
    ),
    "franka_panda": DataSet(
        read=_readers.read_franka_panda,
        joint_names=tuple(f"panda_joint{i}" for i in range(1, 8)),
        drop_repeated=True,
        urdf=_example_robot_data,
        licence="GPL-3.0",
        citation=(
            "C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca, "
            '"Dynamic Identification of the Franka Emika Panda Robot With Retrieval '
            'of Feasible Parameters Using Penalty-Based Optimization", IEEE RA-L, '
            "2019."
        ),
        description=(
            "Franka Emika Panda, exciting trajectory of 21 s. Torque of the "
            "link-side sensors, gravity included."
        ),
        protocol=Protocol(cutoff=10.0),
    ),
    "tflex_1dof": DataSet(
        read=_readers.read_tflex_1dof,
        joint_names=("hinge",),
        torque_units=("count",),
        dt=_readers.TFLEX_PERIOD,
        licence="MIT, (c) 2019 Wouter van Dijk",
        citation="W. van Dijk, repository Inverse_dynamics_learning, 2019.",
        description=(
            "Flexure hinge with a direct-drive motor under random motion. Current "
            "in driver counts, spring and cogging instead of dry friction."
        ),
        # A flexure hinge: practically no dry friction.
        protocol=Protocol(cutoff=40.0, friction=("viscous", "offset")),
    ),
    "bam_xl330": DataSet(
        read=_readers.read_bam_xl330,
        joint_names=("servo",),
        torque_units=("V",),
        licence="Apache-2.0",
        citation=(
            'M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended Friction Models '
            'for the Physics Simulation of Servo Actuators", ICRA 2025.'
        ),
        description=(
            "Servo with a pendulum. The torque stands for the motor voltage; motor "
            "constant and resistance are unknown, back-EMF counts as friction."
        ),
        protocol=Protocol(cutoff=12.0, standstill=0.05),
    ),
    "kuka_lbr_med7": DataSet(
        read=_readers.read_kuka_lbr_med7,
        joint_names=tuple(f"A{i}" for i in range(1, 8)),
        dt=_readers.LBR_PERIOD,
        urdf=DataFiles.published_urdf,
        licence="MIT",
        citation="lbr-stack, repository dynamic_parameter_identification.",
        description=(
            "KUKA LBR Med 7 with an unmodelled tool. Torque of the joint sensors, "
            "sign changed to that of the usual joint torque."
        ),
        protocol=Protocol(cutoff=4.0),
    ),
    "dfki_double_pendulum": DataSet(
        read=_readers.read_dfki_double_pendulum,
        joint_names=("shoulder", "elbow"),
        licence="BSD-3-Clause",
        citation=(
            "F. Wiebe, S. Kumar, L. Shala, S. Vyas, M. Javadi, F. Kirchner, "
            '"Open Source Dual-Purpose Acrobot and Pendubot Platform", IEEE '
            "Robotics & Automation Magazine 31(2), 2024."
        ),
        description={
            "short": f"{_PENDULUM} Torque measured by the drives.",
            "long": f"{_PENDULUM} Torque as commanded.",
        },
        protocol=Protocol(cutoff=12.0),
    ),
    "tiago": DataSet(
        read=_readers.read_tiago,
        joint_names=("torso_lift_joint", *(f"arm_{i}_joint" for i in range(1, 8))),
        position_units=("m", *("rad",) * 7),
        torque_units=("N", *("N m",) * 7),
        urdf=_example_robot_data,
        licence="Apache-2.0",
        citation=_FIGAROH,
        description=(
            "TIAGo, torso lift and seven arm joints. Torque from motor currents, "
            "useful for arm_1 to arm_4 only."
        ),
        protocol=Protocol(cutoff=5.0),
    ),
    "unitree_go2": DataSet(
        read=_readers.read_unitree_go2,
        joint_names=tuple(
            f"{leg}_{joint}_joint"
            for leg in ("FL", "FR", "RL", "RR")
            for joint in ("hip", "thigh", "calf")
        ),
        dt=_readers.GO2_PERIOD,
        urdf=DataFiles.published_urdf,
        source=(
            "https://github.com/RX-00/sim2real-robot-identification/tree/1a22bd0 "
            "(robot_model/go2/go2.xml; datasets/go2/traj_*.pt, which fetch_unitree_go2 "
            "reads as run_*.npz, see there)"
        ),
        licence="BSD-3-Clause, (c) DLS Lab, Istituto Italiano di Tecnologia",
        citation=(
            "DLS Lab, Istituto Italiano di Tecnologia, repository "
            "sim2real-robot-identification."
        ),
        description=(
            "Unitree Go2 held in the air, all legs moving. The torque is the command "
            "of a PD law, made of the measured positions and speeds themselves."
        ),
        # The automatic low-pass takes noise of the command, which is that of the
        # encoders and so in both channels, for motion.
        protocol=Protocol(
            train=("run_0", "run_1"), test=("run_2", "run_3"), cutoff=10.0
        ),
    ),
}


def protocols():
    """Return name -> `Protocol`, with its loader, of the demo and every set."""
    # The public loaders are made of the catalogue, so they are looked up, not imported.
    from sklearn_vbjfa import datasets

    demo = Protocol(load=datasets.load_demo_recording)
    return {
        "demo": demo,
        **{
            name: replace(entry.protocol, load=getattr(datasets, f"fetch_{name}"))
            for name, entry in CATALOGUE.items()
        },
    }
