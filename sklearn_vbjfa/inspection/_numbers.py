"""Thresholds of the log inspection."""

import numpy as np

# -- hypotheses ------------------------------------------------------------------------

# Prior log odds of a hypothesis against the log as it is, posterior ones from which it
# is reported or within which two are rivals, and standard errors of a 90 % interval.
PRIOR, DECISIVE, RIVAL, INTERVAL = -np.log(100.0), 5.0, np.log(19.0), 1.645
# Log odds by which zeros, where errors hardly fall, and a contact must surpass other
# masses and springs.
FAR = 25.0
# Another reading must lower the squared errors of all joints by this factor [log], and
# those of the joints that it changes by the second, each.
CLEAR, CLEAR_OF_JOINT = np.log(2.0), np.log(4.0)
# Order, direction and zero are left alone if all joints have at most this relative
# error.
GOOD_FIT = 0.1
# Changes of one kind that the likelihood is computed of.
MOST_LIKELY = 6
# Rows of the rough score of changes, at least, and times the joints. In it, described
# torques of another sign count as four times this share of their square.
LEAST_ROUGH, ROUGH, ROUGH_PRIOR = 60, 4000, 0.05
# Places by which all columns may be shifted: columns that belong to no joint may stand
# before the first one.
ROLLED = 3
# Zeros that are tried [rad], deviation of the prior of a step from there, or of that of
# a factor [log], and the half step of derivatives.
ANGLES = np.radians([-120, -80, -40, 40, 80, 120, 180])
STEP_OF_ZERO, SLOPE = 0.5, 1e-4
# Positions begin at zero within this share of their range, and a zero is another one
# from this angle on [rad], or from the next one where only few joints have another.
AT_ZERO, MOVED, FAR_ZERO = 1e-3, 0.05, 0.3
# With a larger relative error the sign of a torque is not judged, nor if friction says
# the other by so many standard errors.
WORST, SURE = 0.3, 5.0
# Torques of all joints together are not this many times the described ones by chance,
# nor is a single one this many times as large as it should be: the rotor of a gear may
# be many times its link. Of commands one order of magnitude is asked for.
SCALE, SINGLE, COMMANDED = 2.5, 20.0, 10.0
# Torques are in another unit if in the median over the joints they are this many times
# the limits of the description [N m or N], of which some are no limits.
BEYOND_LIMITS, NO_LIMIT = 5.0, 1e6
# A torque is noise if it is less than this share of the described one, and its relative
# error above this. Torques are computed if they agree to the last share.
SILENT, UNRELATED, COMPUTED = 0.1, 0.85, 0.007
# Torques are those of another robot if its description leaves this share of them and
# they are small, or this one of some joints.
OF_ANOTHER, UNFOLLOWED = 0.3, 0.65
# A factor of gravity, or of inertia, that is below this with its error is none, unless
# slides hold more than this share of their weight if they were upright.
NO_WEIGHT, HELD = 0.5, 0.15
# A base is mounted otherwise if it is turned by more than this [rad] (less is a tilt,
# which the search finds among its rivals), and pulls as gravity does to this factor.
TURNED, AS_HEAVY = np.radians(15.0), 1.5
# Sample periods that are tried, as multiples, but for those at which a joint exceeds
# its limit by this factor.
PERIODS, PLAUSIBLE = (1e3, 1e2, 10.0, 2.0, 0.5, 0.1, 1e-2, 1e-3), 2.0
# A joint without a speed limit does not move faster than this [rad/s, m/s], nor any
# joint faster than its limit by this factor. Speeds are taken over so many samples,
# lest encoder noise pass for motion.
FASTEST_TURN, FASTEST_SLIDE, TOO_FAST, SPEED_SAMPLES = 60.0, 10.0, 5.0, 5
# A robot this much slower than its limits does not really move, and motions are seldom
# sampled at that period [s]; 5 kHz read as ms are 0.2.
TOO_SLOW, LONG_PERIOD = 0.01, 0.15
# A lag is told from none if it is this many times its deviation, and raises the squared
# error of no joint by more than this [log], or this share of the fall of all; steps,
# the last one below this [samples]; time constants of a low-pass, over the lag.
LEAST_LAG, HARM, MOVES, SAMPLE, CONSTANTS = 3.0, 0.125, 8, 0.75, (0.7, 1.0, 1.4)
# A contact pushes a joint by this many deviations of what is left elsewhere, and lasts
# for this part of the log at least; places of its ends that are tried.
CONTACT, SHORTEST_CONTACT, CONTACT_ENDS = 3.0, 20, 80
# A joint without limits does not turn farther than this within a log, positions in
# degrees run beyond limits by more than this [rad], and encoder counts are whole
# numbers that span at least this range.
LARGEST_TURN, FAR_BEYOND, FEWEST_COUNTS = 25.0, 5.0, 25.0
# Factors [log] of positions that are tried joint by joint; a factor is known below this
# error, and that of a wrong gear from here on.
RATIOS, KNOWN_RATIO, OF_GEAR = np.linspace(-2.1, 2.1, 14), 0.1, 0.1
# Signs must lower the squared error of a torque of one sign by this factor, and both
# must be had by this share of the rows. Rows with which signs are looked for, most
# rounds, and dry friction to begin with, in root mean squares of the rigid torque.
SIGN_GAIN, RARE, LOOKED_AT, SIGN_ROUNDS = 2.0, 0.02, 20_000, 50
DRY_STARTS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, np.inf)

# -- likelihood and filter -------------------------------------------------------------

# Entries of all regressors together, and rows, at least and at most; more rows cost
# time without adding evidence.
MOST_ENTRIES, LEAST_ROWS, MOST_ROWS = 2_000_000, 200, 600
# Relative error of the described bodies, and by how much it is larger where they were
# invented; deviation of the prior of friction, rotor and offset, in units of torque, of
# what offsets differ by between recordings, if these are not many, and of factors.
NOMINAL_ERROR, INVENTED, WIDE, OFFSETS, MANY, FACTOR = 0.5, 8.0, 10.0, 0.3, 20, 1e3
# What friction that feeds the motion costs a joint at most: controllers compensate it.
FRICTION = 15.0
# Iterations of the noise, the relative change that ends them, passes of factors, and
# the change [log] of a factor that ends them.
ITERATIONS, CONVERGED, PASSES, SETTLED = 20, 1e-2, 6, 0.05
# Least variances, relative to a torque's and to the largest of all torques, and the
# autocorrelation at which residuals count as independent.
LEAST_NOISE, LEAST_VARIANCE, INDEPENDENT = 1e-7, 1e-12, 0.05
# Shorter recordings are skipped [samples]. With fewer moving rows a joint is not
# judged, nor with fewer than so many times the parameters of its torque, unless there
# are enough.
MIN_SAMPLES, FEWEST_ROWS, ROWS_PER_PARAMETER, ENOUGH_ROWS = 64, 70, 2, 120
# The cut-off is this multiple of the frequency below which 90 % of the velocity's power
# lies, but the filter remains short against the longest recording. That of the states
# is at least this multiple of it.
CUTOFF_PER_BANDWIDTH, CUTOFF_PERIODS, SMOOTH = 9.0, 36.0, 5.5
# A joint stands below this share of its speed.
STANDSTILL = 0.02
# It moves in filtered rows if it does in this share of their low-pass, and throughout.
MOVING, THROUGHOUT = 0.9, 0.98

# -- rows ------------------------------------------------------------------------------

# The mean squared step of shuffled rows is twice the variance; seven tenths of that is
# a correlation of 0.3. Of two robots in turn it is this many times that of two rows.
# Noise has no order either: a joint moves at least this much [rad or m], and is at rest
# if its travel is below this many standard deviations of its noise.
SHUFFLED, IN_TURN, LEAST_MOTION, STILL_TRAVEL = 0.7, 2.0, 0.01, 12.0
# In fewer rows it is not looked for.
SHORT_RUN = 16
# A jump is a full turn to within this fraction of one.
TURN_LEFT = 0.15
# Repeated rows that are reported; above the last share they are a warning.
FEWEST_REPEATED, REPEATED_SHARE, MANY_REPEATED = 3, 0.002, 0.1
# The logger was frozen if this many rows are equal while a joint moves at this share of
# its speed over this many samples right before and right after them.
FROZEN_ROWS, HELD_SPEED, BESIDE = 5, 0.1, 3
# Steps of this multiple of the channel's resolution are not rounding; the rate of a
# channel takes at least this many of them, and this share of all, most of which must
# come equally often.
STEP, FEWEST_STEPS, STEP_SHARE, SAME_RATE = 4.0, 20, 0.3, 0.8
# A torque is coarse if its quantisation error exceeds this share of its spread, useless
# if its range has fewer steps than this, nothing if it is below this [N m or N], and
# constant if its range is below this share of it.
COARSE, LEVELS, NOTHING, ROUNDED = 0.05, 5, 1e-9, 1e-12
# Clipping: samples within this share of the channel's range of an extreme value, in
# runs of at least this length, in at least this many places (or one run of the long
# length, in a channel that does not repeat itself), and denser by this factor than the
# torques next to the extreme value: for a sine without noise the factor is 3.4.
PLATEAU, PLATEAU_RUN, PLATEAU_RUNS, LONG_PLATEAU, DENSITY = 1e-3, 5, 3, 12, 8.0
# Clipped samples are a warning from this share on: on simulated arms, 0.3 % of them
# raise the error of no joint by more than 3 %, and 1 % of them by up to 70 %.
MANY_CLIPPED = 0.005
# Torques of zero are dropouts if the values before and after are this many times the
# usual step and this share of the spread, in at least this many places.
DROPOUT_STEP, LEAST_DROPOUT, DROPOUT_RUNS = 4.0, 0.05, 3
# A torque is stuck if it keeps a value for this many samples, or for this time [s] if
# its joint was at rest before, and repeats itself no more often than this in others.
STUCK_RUN, ARRIVES, STUCK_REPEATS = 50, 0.1, 0.1
# Drives are off if no torque exceeds this share of its root mean square while the
# weight exceeds the second one.
OFF, LOADED = 0.05, 0.2
# A position keeps its value over so many samples if it travels less than this share of
# what it usually does there. Within one sample a joint stops with this many times its
# usual acceleration; all samples of such stops are this share of the recording.
LEAST_STOP, STANDS, SUDDEN, USUAL, STUCK_SHARE = 10, 3e-3, 3.5, 0.99, 0.03
# ... or an encoder is dead if for this many samples nearly this share equals the one
# before, although its noise is so many times its resolution and less than the last
# share of all other samples does.
DEAD_RUN, EXACT, NOISY, SELDOM = 50, 0.8, 3.0, 0.005
# Steps and spikes, in robust standard deviations of the prediction by the neighbours,
# in recordings of at least this many samples, and at least this share of the channel's
# range. A larger share of outliers is noise, not a fault of single samples. Torques are
# compared with their median over so many samples.
OUTLIER, FEWEST_AROUND, LEAST_JUMP, MOST_OUTLIERS, MEDIAN = 25.0, 16, 0.003, 0.01, 5
# Torques of several joints that are one multiple of their motion agree with it to
# `GOOD_FIT`, and in the factor to this share; a single one equals it to that. A torque
# that is a multiple of another one agrees to the second.
SAME, COPY = 0.02, 5e-4

# -- what a motion shows ---------------------------------------------------------------

# A joint has one speed if this share of its moving time, about the middle, lies in a
# range of this share of the speed: even speeds deviate by a tenth of their mean then.
MIDDLE, ONE_SPEED = 0.8, np.sqrt(12.0) / 10.0
# What saturates after a reversal must have done so in either direction several times.
# Range of positions below which what varies with them looks like a spring [rad].
FEW_REVERSALS, WIDE_RANGE = 10, np.radians(60.0)
