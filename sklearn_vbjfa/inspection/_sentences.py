"""Messages of all findings, by kind."""

import numpy as np

from sklearn_vbjfa.recording import ChannelFinding, listed_joints

# {who}: names of the joints concerned; {names}: of all; {evidence}: log odds against
# the unchanged log, and the factor by which squared torque errors fall. A colon
# separates a kind from its variant.
_HELD = (
    "The {what} of {who} has a new value only every {k:.3g} rows: it is late by "
    "{late:.3g} ms and goes in steps. Keep one row for each new {what} (dt={dt:.4g})."
)
_COPIED = (
    "The {what} of {second} is {factor:.4g} times that of {first} in every row. Log "
    "the other channel, or leave the joint out (joint_names)."
)
_SWAPPED = (
    "The {what} of {who} appear to be swapped ({evidence}): their columns hold those "
    "of {held}. Exchange the columns."
)
_UNIT = (
    "The positions of {who} look like {unit}: {name} runs from {low:.4g} to "
    "{high:.4g}, and in {unit} they explain the torques better ({evidence}). Convert "
    "them, or {given}."
)
_UNVERIFIED = (
    "The size and the signs of the torques cannot be verified, nor the zeros and the "
    "direction of gravity: "
)
SENTENCES = {
    # -- rows
    "shuffled_rows": "The rows are not in the order of time, or of two robots in turn: "
    "positions change by {change:.2g} times their spread in a row. Sort them by time "
    "(no shuffle), and keep those of one robot. "
    "Of single poses `sklearn-vbjfa identify --for gravity` corrects the masses.",
    "shuffled_rows:blocks": "The position of {who} jumps {count} time(s), first at "
    "{place}: blocks of rows are out of order. Sort them, or split them (groups).",
    "wrapped_position": "The position of {who} is wrapped: it jumps by {turn} {count} "
    "time(s), first at {place}. Unwrap each recording for itself (numpy.unwrap).",
    "wrapped_torque": "The torque of {who} jumps by {span:.4g} {count} time(s), first "
    "at {place}: its integers overflow. Log wider ones, or unwrap it (numpy.unwrap).",
    "still_joint": "{who} never moves: its position stays within {range:.3g} of "
    "{mean:.4g}, which is its noise. Name the others in --joints, or record it moving.",
    "still_joint:all": "No joint moves: positions vary by {range:.3g}, within their "
    "noise. Check the position columns.",
    "repeated_rows": "{count} rows ({share}) repeat the row before them, up to "
    "{longest} in a row, the first at {place}. Leave them out, keep the time stamps.",
    "interpolated_rows": "All channels are on straight lines in {count} rows "
    "({share}), first from {place} on, for up to {seconds:.3g} s: a gap was filled by "
    "interpolation. Leave these rows out.",
    "missing_rows": "All positions advance by several steps in a row {times} time(s), "
    "first at {place}: rows are missing. Log the time of each row.",
    "empty_rows": "All torques are zero in {count} rows ({share}) amid the motion, "
    "first at {place}: lost readings, or two sources in one log. Leave these rows out.",
    "empty_rows:off": "All torques are zero {times} time(s), first from {place} on, "
    "for up to {seconds:.3g} s, though links have weight: drives were off, or readings "
    "were lost. Leave these rows out.",
    "held_position": _HELD,
    "held_torque": _HELD,
    "constant_torque": "The torques of {who} are constant ({values}) while the joints "
    "move: nothing was measured. Log torques or currents, or lock these joints.",
    "coarse_torque": "The torque of {who} goes in steps of {step:.3g} and has a spread "
    "of {spread:.3g}: it is coarse. Record it finer, or leave the joint out.",
    "torque_dropouts": "The torque of {who} stays at {level:.4g} {times} time(s) while "
    "the robot moves ({share}, up to {seconds:.3g} s): lost readings. Leave them out.",
    "torque_outliers": "The torque of {who} has {count} outlier(s) ({share} of its "
    "samples), the first at {place}. Leave these rows out.",
    "clipped_torque": "The torque of {who} is clipped at {where}: {share} of its "
    "samples lie there, up to {longest} in a row. Record a slower motion.",
    "stuck_position": "The position of {who} stays at {level:.4g} for {seconds:.3g} s "
    "({count} rows, the first at {place}): the encoder was stuck. Leave them out.",
    "position_jumps": "The position of {who} jumps {count} time(s), first {step:.3g} "
    "at {place}. Split the recording there (groups), or leave wrong samples out.",
    "position_jumps:outliers": "The position of {who} has wrong samples at {count} "
    "place(s), the first at {place}, by {step:.3g}. Leave these rows out.",
    "copied_position": _COPIED,
    "copied_torque": _COPIED,
    "motion_as_torque": "The torques are the {what} of the joints times {factor:.3g}, "
    "to {share}: the wrong columns were taken. Give those of the torques (columns).",
    "wrong_states": "The motion of {who} is inconsistent: the derivatives of the {of} "
    "are {factor:.2g} times those given ({name}). Check the order of the columns, "
    "their units and dt.",
    "wrong_states:swapped": "The {of} of {who} are the derivatives of the columns "
    "given as theirs: exchange the two (columns).",
    "wrong_states:unused": "The velocities of {who} have another unit: the derivatives "
    "of the positions are {factor:.2g} times them ({name}). They are not used.",
    # -- positions and time
    "position_degrees": _UNIT,
    "position_turns": _UNIT,
    "position_unit": "The positions of {who} are not in radians or {unit}: {name} runs "
    "from {low:.4g} to {high:.4g}. By the torques, a radian of the joint is in the "
    "log: {each}. Divide columns of motors by these gear ratios{power}.",
    "position_unit:motor": "The positions of {who} are those of the motors, or in "
    "{unit}: {name} runs from {low:.4g} to {high:.4g}. In {unit} the torques are far "
    "too small ({evidence}). Divide positions of motors by the gear ratios, and "
    "multiply their torques by them; if they are {unit}, convert them and give the "
    "factors of the torques to N m.",
    "position_unit:gear": "The position of {who} has another factor: by the torques, a "
    "radian or metre of the joint is in the log: {each} ({evidence}). Divide the "
    "position by this gear factor{power}.",
    "position_counts": "The positions of {who} are not in {units}: {name} has "
    "{numbers} from {low:.6g} to {high:.6g}; they look like {guess} or positions of "
    "the motors. Convert them to {unit}, from the joint's zero.",
    "position_zero": "The zero of {who} appears to be off ({evidence}). Add to the "
    "positions, about [rad]: {values}, or, if the robot is mounted in another way, "
    "carries a tool, or has a joint without columns at another angle than zero, "
    "correct the model.",
    "position_zeros": "All positions begin at zero, and the torques require other "
    "zeros ({evidence}): the encoders were set to zero at power-up. Add to the "
    "positions, about [rad]: {values}.",
    "swapped_torques": _SWAPPED,
    "swapped_positions": _SWAPPED,
    "swapped_joints": _SWAPPED.removesuffix(".") + ", or name the joints in the order "
    "of the columns (joint_names).",
    "flipped_joint": "The direction of {who} in the log is opposite to that in the "
    "model ({evidence}). Multiply position and torque by -1, or turn the axis.",
    "position_sign": "The position of {who} has the wrong sign ({evidence}). Multiply "
    "it by -1.",
    "command_unit": "The {what} of {who} are in {unit} ({evidence}). Convert them, or "
    "{given}.",
    "command_sign": "The {what} of {who} have the wrong sign ({evidence}). Multiply "
    "them by -1.",
    "swapped_commands": _SWAPPED,
    "coupled_position": "The position of {name} contains that of {other}, as of "
    "coupled axes ({evidence}). Replace it by that of {name} {minus} that of {other}"
    "{also}.",
    "wrong_dt": "dt={dt:.6g} s is inconsistent with the motion: a period of "
    "{period:.3g} s agrees better ({evidence}). Give dt, the sample period in "
    "seconds, or correct the time stamps.",
    "wrong_dt:fast": "Implausible speed: with dt={dt:.6g} s {name} moves at "
    "{speed:.3g} {unit}, and {limit:.3g} would be five times what it can. Give dt in "
    "seconds, and positions in rad or m, of the joints (not of motors).",
    "wrong_dt:slow": "dt={dt:.6g} s is inconsistent with the motion: the fastest "
    "joint, {name}, moves at {speed:.2g} {unit}, far less than it can. Give dt in "
    "seconds (not milliseconds, nor a rate in Hz).",
    # -- torques
    "torque_sign": "The torque of {who} has the wrong sign: with the other one "
    "friction, weight and inertia agree with the description ({evidence}).{also} "
    "Multiply it by -1.",
    "torque_unit": "All torques together are {factor:.3g} ({low:.2g} to {high:.2g}) "
    "times what the described masses require: they are motor currents or in another "
    "unit than N m{inside}, or the described masses are wrong. Give the factor to N m "
    "(gains={gain:.3g}, times those given before){unknown}; if they are N m, {free}.",
    "torque_unit:limits": "The torques of {who} reach {most:.3g} times the limits of "
    "the description, in the median: they are in another unit than N m or N, or the "
    "limits are wrong. Give the factors to N m (gains), or correct the limits.",
    "torque_factors": "The torques have different factors against what the described "
    "masses require ({each}): motor currents, or shares of each joint's rated torque. "
    'Give the factors to N m (gains), or gains="unknown".',
    "driving_friction": "By the torques, friction drives {who} instead of braking: "
    "{reverse}friction was subtracted from the torques, twice or with the wrong sign. "
    "Log the measured torques, in the order of time.",
    "mixed_torques": "The torques of {who} contain those of other joints, as of "
    "cables or a differential ({evidence}). Replace them by combinations of the logged "
    "ones [N m or N]: {each}.",
    "gear_factor": "The torque of {who} is {factor:.3g} times what the described "
    "masses require: {units}. Multiply it by the factor to N m or the gear ratio "
    "(about {ratio:.3g} would fit).",
    "gear_factor:commanded": "The commanded torques are {factor:.2g} times those of "
    "the described robot: check kp [N m/rad] and kd [N m s/rad] (not per degree, nor "
    "in units of the firmware), and the unit of the positions.",
    "other_robot": "The torques are {size:.2g} times the described ones (median) and "
    "{share} of them is not explained: wrong description, or another unit.",
    "silent_torque": "The torque of {who} does not follow the motion and is {size:.2g} "
    "times what the description requires: noise alone. Check the cable or the column, "
    "or leave the joint out (joint_names).",
    "unsigned_torque": "The torques of {who} have one sign only, and signs that change "
    "explain them better, as of unsigned currents. Give "
    "drive=CurrentDrive(signed=False), which finds the signs.",
    "unsigned_torque:half": "The torque of {who} has one sign only and is zero in "
    "{share} of its samples amid the motion: the other one was lost. Log signed ones.",
    "no_gravity": "The torques contain no weight of the links, or a part: its factor "
    "is {share:.2f} ± {error:.2f} (described: up to {heavy:.3g} N m on {who}).{other} "
    "Log the torques before the controller subtracts gravity.",
    "no_gravity:unit": "The torques contain no weight of the links, and are "
    "{factor:.3g} ({low:.2g} to {high:.2g}) times the described ones: motor currents "
    "or another unit than N m{inside}. Log them before the controller subtracts "
    "gravity, and give the factor to N m (gains={gain:.3g}, times those given before).",
    "no_gravity:joints": "The torques of {who} contain no weight of the links "
    "({evidence}; described weight: up to {heavy:.3g} N m), those of other joints do. "
    "Log them before the controller subtracts gravity.",
    "no_gravity:slides": "The mean force lacks the described weight ({each}): the "
    "controller subtracts it, or a counterbalance carries it. Log the whole forces.",
    "weight_factor": "The torques contain {share:.2f} ± {error:.1g} times the weight "
    "of the links (described: up to {heavy:.3g} N m on {who}; {evidence}): a part was "
    "subtracted, or it was added. Log the torques of the motors. As probable: a period "
    "of {period:.3g} s and another unit (gains={gain:.3g}).",
    "gravity_only": "The torques contain the weight of the links alone: the factor of "
    "their inertia is {part:.2f} ± {error:.2f}. Log the torques of the motors.",
    "computed_torque": "The torques of {who} are those of the description to {share}, "
    "without friction: a model was logged, not a measurement. Log measured torques.",
    "base_orientation": "By the torques, gravity pulls along ({pull}) of the base "
    "frame, {angle:.0f} degrees from the description: the base is mounted otherwise, "
    "as on a wall or a ceiling. Turn it in the description (a free base: by "
    "--base-orientation).",
    "delay": "All torques are {size:.4g} ± {error:.2g} ms {late} against the positions "
    "({evidence}): two clocks, or a delay of the torques. The search shifts them by "
    "this lag.",
    "delay:alone": "All torques are {size:.4g} ± {error:.2g} ms {late} against the "
    "positions ({evidence}). Shift the torques of this recording by this lag.",
    "delay:drift": "The clock of the torques is about {share} {ahead} against that of "
    "the positions: their lag changes by {size:.3g} ms in the log ({evidence}). Log "
    "both with the stamps of one clock.",
    "torque_lowpass": "All torques look filtered, by a low-pass with a time constant "
    "of about {size:.2g} ms ({evidence}): log them before the filter.",
    "external_force": "From {begin:.1f} to {end:.1f} s {where} something else "
    "acts on the robot ({pushes}; {evidence}), such as a contact. Leave this interval "
    "out.",
    "unverified:massless": _UNVERIFIED + "no body of the description has mass.",
    "unverified:weightless": _UNVERIFIED + "gravity loads no joint of the description.",
    "unverified:size": "The size of the torques cannot be verified: gravity is nearly "
    "constant in this motion, and inertia is like rotor inertia.",
    "unverified:order": "The columns are assumed to be in the order of the description "
    "({names}): by name, or with left and right exchanged, torques agree as well.",
}


def finding(
    kind, names, joints, severity, *, value=np.nan, remedy=None, rivals=(), **facts
):
    """Return a finding on some joints, with the message of its kind."""
    # kind: with its variant, if any; rivals: kinds that are nearly as probable.
    joints = tuple(int(j) for j in np.atleast_1d(joints))
    facts = {"who": listed_joints(names, joints), "names": ", ".join(names)} | facts
    message = SENTENCES[kind].format(**facts)
    if rivals:
        others = ", ".join(rivals).replace("_", " ")
        message += f" Nearly as probable by this log: {others}."
    kind, _, _ = kind.partition(":")
    return ChannelFinding(
        kind, joints, severity, message, value, remedy or {}, tuple(rivals)
    )


def percent(share):
    return f"{100 * share:.2g} %"
