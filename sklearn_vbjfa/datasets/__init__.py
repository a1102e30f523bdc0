"""Robot recordings: measured sets, found on disk or downloaded, and simulated ones."""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

if TYPE_CHECKING:
    from sklearn_vbjfa.datasets._closed_loop import (
        ClosedLoopRecording,
        TrackingResult,
        make_closed_loop_recording,
        simulate_tracking,
    )
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
    from sklearn_vbjfa.datasets._robot_recording import (
        SimulatedRecording,
        load_demo_recording,
        make_robot_recording,
    )
    from sklearn_vbjfa.datasets._robots import load_arm_model, load_head_model
    from sklearn_vbjfa.datasets._synthetic import NoisyRegression, make_noisy_regression
    from sklearn_vbjfa.inspection import inspect_recording
    from sklearn_vbjfa.recording import Recording, read_recording

# A name is imported when it is asked for: the demonstration needs no loader of others.
# What is not in __all__ is for the command line, and for tests of the catalogue, the
# downloads and the simulators.
_MODULES = {
    ".inspection": ("inspect_recording",),
    ".recording._reader": ("read_recording",),
    ".recording._recording": ("Recording",),
    "_closed_loop": (
        "ClosedLoop",
        "ClosedLoopRecording",
        "Gains",
        "TrackingResult",
        "closed_loop_chunks",
        "low_gains",
        "make_closed_loop_recording",
        "simulate_tracking",
    ),
    "_measured": (
        "SETS",
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
        "remote_files",
    ),
    "_protocols": ("Protocol", "protocols"),
    "_robot_recording": (
        "SimulatedRecording",
        "load_demo_recording",
        "make_robot_recording",
    ),
    "_robots": (
        "EFFECTS",
        "demo_arm_urdf",
        "draw_motion",
        "draw_plant",
        "joint_range",
        "load_arm_model",
        "load_head_model",
        "rigid_torques",
        "with_inertias",
    ),
    "_synthetic": ("NoisyRegression", "make_noisy_regression"),
}
__all__ = [
    "ClosedLoopRecording",
    "NoisyRegression",
    "Recording",
    "SimulatedRecording",
    "TrackingResult",
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
    "load_arm_model",
    "load_demo_recording",
    "load_head_model",
    "make_closed_loop_recording",
    "make_noisy_regression",
    "make_robot_recording",
    "read_recording",
    "simulate_tracking",
]
__getattr__, __dir__ = _lazily(__name__, _MODULES)
