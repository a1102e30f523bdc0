"""Robot recordings: measured sets, found on disk or downloaded, and simulated ones."""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

if TYPE_CHECKING:
    from sklearn_vbjfa.datasets._measured import (
        fetch_bam_xl330,
        fetch_dfki_double_pendulum,
        fetch_emps,
        fetch_franka_panda,
        fetch_kuka_kr300,
        fetch_kuka_lbr_med7,
        fetch_staubli_tx40,
        fetch_tflex_1dof,
        fetch_tiago,
        fetch_unitree_go2,
        fetch_ur5,
    )
    from sklearn_vbjfa.datasets._noisy_regression import make_noisy_regression
    from sklearn_vbjfa.datasets._simulated import (
        SimulatedRecording,
        load_demo_recording,
        make_robot_recording,
    )
    from sklearn_vbjfa.inspection._inspect import inspect_recording
    from sklearn_vbjfa.recording._reader import read_recording
    from sklearn_vbjfa.recording._recording import Recording

__all__ = [
    "Recording",
    "fetch_bam_xl330",
    "fetch_dfki_double_pendulum",
    "fetch_emps",
    "fetch_franka_panda",
    "fetch_kuka_kr300",
    "fetch_kuka_lbr_med7",
    "fetch_staubli_tx40",
    "fetch_tflex_1dof",
    "fetch_tiago",
    "fetch_unitree_go2",
    "fetch_ur5",
    "inspect_recording",
    "load_demo_recording",
    "make_noisy_regression",
    "make_robot_recording",
    "read_recording",
]
# Names are imported lazily: the demonstration does not need the other loaders. Names
# that are not in __all__ are for tests and benchmarks.
_MODULES = {
    ".inspection": "inspect_recording",
    ".recording._reader": "read_recording",
    ".recording._recording": "Recording",
    "_measured": ["SETS", "remote_files"]
    + [name for name in __all__ if name.startswith("fetch_")],
    "_noisy_regression": "make_noisy_regression",
    "_simulated": """
        SimulatedRecording demo_arm_urdf joint_range load_demo_recording
        make_robot_recording recording_fields rigid_torques speed_limit true_inertias
    """,
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
