"""Options that commands for a recording of one's own have in common."""


def add_recording(parser):
    """Add the options that say how a recording is read."""
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
        "--signals",
        default=None,
        metavar="NAMES",
        help="other columns of RECORDING that friction and offsets may vary with, such "
        "as temperature,voltage; by default all that hold numbers; none for none",
    )


def add_model(parser):
    """Add the options that say what is identified."""
    parser.add_argument(
        "--friction",
        default="viscous,coulomb",
        metavar="NAMES",
        help="friction of the declared model: none, or any of viscous,coulomb,offset,"
        "rotor_inertia; by default viscous,coulomb",
    )
    parser.add_argument(
        "--gain",
        default=None,
        metavar="unknown",
        help="unknown: tau1..taun are proportional to the torques (motor currents), "
        "each with a factor of its own; the factors are identified relative to one of "
        "them",
    )
    parser.add_argument(
        "--known-mass",
        action="append",
        default=[],
        metavar="LINK=KG",
        help="with --gain unknown, a mass that fixes the common factor: of a link with "
        "what is fixed to it, or payload=KG of what is picked up or put down; may be "
        "repeated",
    )
    parser.add_argument(
        "--cutoff",
        default="auto",
        metavar="HZ",
        help="cut-off of the low-pass for torques and regressors; by default auto, "
        "from the motion; none for no low-pass",
    )


def add_force(parser):
    """Add the option that lets files be overwritten."""
    parser.add_argument(
        "--force",
        action="store_true",
        help="write to --out even if it holds files of others, or an input of this run",
    )
