"""Recordings: data class, readers of files, time stamps, signals and drives."""

from sklearn_vbjfa import _lazily

# `Recording` and `read_recording` are public in `sklearn_vbjfa.datasets`; other names
# are for use by other subpackages.
_MODULES = {
    "_signals": (
        "ChannelFinding",
        "OfferedSignals",
        "carries_joint_names",
        "check_useful_signals",
        "fault",
        "findings_in_order",
        "listed_joints",
        "positions_and_signals",
        "signals_for",
        "scan_signals",
        "torques_in_order",
    ),
    "_drives": (
        "CurrentDrive",
        "Drive",
        "PDDrive",
        "VoltageDrive",
        "check_delay",
        "parse_drive",
    ),
    "_reader": ("common_folder", "read_recording"),
    "_recording": (
        "Recording",
        "bridged",
        "check_clock",
        "check_cutoff",
        "check_dt",
        "contiguous_groups",
        "recording_names",
        "take_arrays",
        "take_rows",
        "with_torques_shifted",
    ),
    "_clock": ("check_time_stamps", "filled_gaps", "rows_alternate", "rows_per_sample"),
    "_grid": ("Log", "interpolate", "join"),
    "_table": ("RecordingRefused", "listed", "quoted"),
    "formats": ("expand", "recordings_in"),
}
__all__: list[str] = []
__getattr__, __dir__ = _lazily(__name__, _MODULES)
