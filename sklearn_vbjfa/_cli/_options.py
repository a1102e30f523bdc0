"""Options that commands for a recording of one's own have in common."""

# Options that say how a recording is read, by their names in the arguments.
OF_READING = ("joints", "dt", "columns", "preset", "topic", "time_unit", "gain")

# What is declared of every joint where no option says so.
FRICTION = "viscous,coulomb,offset,rotor_inertia"
# What a recording may be beside a table of one of the formats, for the help.
_RECORDING = (
    " file with columns q1..qn [rad or m], tau1..taun [N m or N] and, optionally, "
    "t [s], segment, and signals such as a temperature; a bag of ROS 1 or 2, MCAP; "
    "the folder of a bag or of a LeRobot data set; - for standard input"
)
_SEVERAL = "; or several such files of one robot, recorded alike"


def _recording():
    """Say what a recording may be."""
    from sklearn_vbjfa.recording import formats

    return formats.TABLES + _RECORDING


def add_files(parser):
    """Add recordings and the robot, all of which there must be."""
    parser.add_argument(
        "recording", nargs="+", metavar="RECORDING", help=_recording() + _SEVERAL
    )
    parser.add_argument(
        "--urdf",
        required=True,
        metavar="FILE",
        help="description of the robot, URDF or MJCF",
    )


def add_optional_files(parser, *, several=True):
    """Add the recording, or several, and the robot, which some runs go without."""
    parser.add_argument(
        "recording",
        nargs="*" if several else "?",
        default=None,
        metavar="RECORDING",
        help=_recording() + (_SEVERAL if several else ""),
    )
    parser.add_argument(
        "--urdf",
        default=None,
        metavar="FILE",
        help="description of the robot, URDF or MJCF",
    )


def add_base(parser):
    """Add the orientation of a base that is free in the description."""
    parser.add_argument(
        "--base-orientation",
        default=None,
        metavar="W,X,Y,Z",
        help="orientation of a base that is free in the description (quadruped, "
        "humanoid) and held, a quaternion in the world; by default that of the "
        "description",
    )


def add_recording(parser, *, signals=True):
    """Add the options that say how a recording is read, and what is read beside it."""
    add_base(parser)
    parser.add_argument(
        "--joints",
        default=None,
        metavar="NAMES",
        help="recorded joints, separated by commas, in the order of the columns "
        "q1..qn; other joints (gripper, wheels) are held at zero; by default all, in "
        "the order of the description",
    )
    parser.add_argument(
        "--dt", type=float, default=None, metavar="S", help="sample period [s]"
    )
    parser.add_argument(
        "--columns",
        default=None,
        metavar="MAPPING",
        help="which columns are which channels, such as "
        '"q=actual_q_{i},tau=actual_current_{i},t=timestamp"; {i} is the number of a '
        "joint from 0 or 1, {joint} its name; a unit may follow: q=pos_{i} [deg]",
    )
    parser.add_argument(
        "--preset",
        default=None,
        metavar="TOOL",
        help="names as tools write them: ros, ur, franka or lerobot; by default they "
        "are recognised",
    )
    parser.add_argument(
        "--topic",
        default=None,
        metavar="NAME",
        help="topic of a bag; by default the only one of joint states",
    )
    parser.add_argument(
        "--time-unit",
        default=None,
        metavar="UNIT",
        help="unit of time: s, ms, us or ns; by default what its name says, or s",
    )
    parser.add_argument(
        "--gain",
        default=None,
        metavar="FACTORS",
        help="factors by which the columns of torques become N m or N, one for each "
        "joint, such as 8,8,5; or unknown: they are proportional to the torques (motor "
        "currents), and the factors are identified relative to one of them",
    )
    if not signals:
        return
    parser.add_argument(
        "--signals",
        default=None,
        metavar="NAMES",
        help="other columns of RECORDING that friction and offsets may vary with, such "
        "as temperature,voltage; by default all that hold numbers; none for none",
    )


def add_model(parser):
    """Add the options that say what is identified."""
    add_friction(parser)
    parser.add_argument(
        "--known-mass",
        action="append",
        default=[],
        metavar="LINK=KG",
        help="with --gain unknown, a mass that fixes the common factor: of a link with "
        "what is fixed to it, or payload=KG of what is picked up or put down; may be "
        "repeated",
    )
    add_bodies(parser)
    add_cutoff(parser)


def add_bodies(parser):
    """Add what the bodies of the description are worth."""
    parser.add_argument(
        "--bodies",
        choices=("prior", "free", "fixed"),
        default="prior",
        help="masses and inertias: near those of the description unless the torques "
        "say otherwise (prior), from the torques alone (free), or as described "
        "(fixed); by default prior",
    )


def add_friction(parser):
    """Add the friction of the declared model."""
    parser.add_argument(
        "--friction",
        default=FRICTION,
        metavar="NAMES",
        help="what the model of each joint has already: none, or any of "
        "viscous,coulomb,offset,rotor_inertia; by default all four",
    )


def add_cutoff(parser):
    """Add the cut-off of the low-pass."""
    parser.add_argument(
        "--cutoff",
        default="auto",
        metavar="HZ",
        help="cut-off of the low-pass for torques and regressors; by default auto, "
        "from the motion; none for no low-pass",
    )


def add_out(parser, ending, *, several=False):
    """Add the folder for the files, by default named with an ending, and --force."""
    # several: whether there may be several recordings.
    also = ", or of the folder of several," if several else ""
    parser.add_argument(
        "--out",
        default=None,
        metavar="DIR",
        help=f"folder for the files; by default the name of RECORDING{also} plus "
        f"-{ending}",
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="write to --out even if it holds files of others, or an input of this run",
    )


def refuse_given(arguments, names, why):
    """Refuse the first of some options that is given."""
    for name in names:
        if getattr(arguments, name) not in (None, []):
            raise ValueError(f"{spelled(name)} {why}.")


def spelled(name):
    """Return an option as it is typed."""
    return f"--{name.replace('_', '-')}"
