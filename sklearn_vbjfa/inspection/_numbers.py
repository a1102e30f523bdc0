"""Thresholds of the log inspection."""

import numpy as np

# -- hypotheses ------------------------------------------------------------------------

# Prior log odds of a hypothesis against the unchanged log, posterior log odds above
# which it is reported, difference within which two are rivals, and half width of a 90 %
# interval in standard errors.
PRIOR, DECISIVE, RIVAL, INTERVAL = -np.log(100.0), 5.0, np.log(19.0), 1.645
# Log odds by which a contact, or zeros whose errors fall little, must exceed other
# masses and springs.
# Least fall of log squared errors by a change of the whole log, averaged over joints,
# and by a change of some joints, for each of these.
FAR_ODDS, CLEAR, CLEAR_OF_JOINT = 25.0, np.log(2.0), np.log(4.0)
# Order, direction and zero are not tested if all relative errors are below this.
# Number of changes of one kind for which the likelihood is computed.
GOOD_FIT, MOST_LIKELY = 0.1, 6
# Rows of the rough score of changes: at least, and times the number of joints. In it,
# described torques of opposite sign cost four times this share of their square.
# Largest shift of all columns: columns of no joint may precede the first one.
LEAST_ROUGH, ROUGH, ROUGH_PRIOR, SHIFTS = 60, 4000, 0.05, 3
# Zeros that are tested [rad], prior standard deviation of a step from there [rad], or
# of a factor [log], and half step of numerical derivatives.
ANGLES = np.radians([-120, -80, -40, 40, 80, 120, 180])
STEP_OF_ZERO, SLOPE = 0.5, 1e-4
# Positions begin at zero within this share of their range. Least change of a zero that
# is reported [rad], and that of few joints, in a motion and from poses.
AT_ZERO, LEAST_ZERO, FAR_ZERO, POSED_ZERO = 1e-3, 0.05, 0.3, 0.15
# Signs of torques are tested below this relative error. A sign is rejected if friction
# has negative power by this many standard errors.
WORST, SIGMAS = 0.3, 5.0
# Least common factor of all torques that is reported; that of a single torque, which
# may be large since a geared rotor may exceed its link, and from poses; of commands.
SCALE, SINGLE, POSED_SCALE, COMMANDED = 2.5, 20.0, 1.6, 10.0
# Torques are in another unit if, in the median over joints, they exceed the limits of
# the description this many times. Limits above the second value are placeholders.
BEYOND_LIMITS, NO_LIMIT = 5.0, 1e6
# A torque is noise if it is below the first share of the described one and its relative
# error above the second. Torques are computed if all errors are below the third.
SILENT, UNRELATED, COMPUTED = 0.1, 0.85, 0.007
# Torques are of another robot if this share (median) is unexplained and they are small,
# or if the second share is unexplained in some joints.
UNEXPLAINED, UNFOLLOWED = 0.3, 0.65
# A factor of gravity or inertia is zero if it is below this including its error, unless
# prismatic joints carry more than the second share of their weight when vertical.
NO_WEIGHT, SLIDE_LOAD = 0.5, 0.15
# The base has another orientation if it is turned by more than this [rad] (less is the
# effect base_tilt) and the magnitude of gravity is right up to this factor.
TURNED, AS_HEAVY = np.radians(15.0), 1.5
# Usual factors of a wrong sample period, or their inverses, unless a joint then exceeds
# its speed limit by the second value.
PERIODS, PLAUSIBLE = (1e3, 100.0, 10.0, 8.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.0), 2.0
# Speed limits of joints without any [rad/s, m/s], implausible multiple of a limit, and
# samples over which speeds are measured to suppress encoder noise.
FASTEST_TURN, FASTEST_SLIDE, TOO_FAST, SPEED_SAMPLES = 60.0, 10.0, 5.0, 5
# Implausibly low share of the speed limits, at sample periods above this [s], which
# are rare (dt=0.2 is 5 kHz in milliseconds); range of small errors of a period [log].
TOO_SLOW, LONG_PERIOD, NEAR_PERIODS = 0.01, 0.15, (0.01, 0.3)
# A lag is reported from this many standard errors on, if it raises the log squared
# error of no joint by more than this, or this share of the total fall. Iterations, and
# step that ends them [samples]; time constants of a low-pass relative to the lag.
LEAST_LAG, HARM, MOVES, SAMPLE, CONSTANTS = 3.0, 0.125, 40, 0.75, (0.7, 1.0, 1.4)
# Longest delay of positions against their commands [s].
# A contact torque exceeds this many residual standard deviations; least duration (as
# the denominator of a share of the log), and number of possible ends.
LATE_COMMAND, CONTACT, SHORTEST_CONTACT, CONTACT_ENDS = 0.15, 3.0, 20, 80
# Largest range of a joint without limits [rad], least excess over limits of positions
# in degrees [rad], and least range of encoder counts.
LARGEST_TURN, FAR_BEYOND, FEWEST_COUNTS = 25.0, 5.0, 25.0
# Factors of positions that are tested per joint [log], error below which a factor is
# known, and least factor of a wrong gear [log]: elasticity has smaller ones.
RATIOS, KNOWN_RATIO, LEAST_GEAR = np.linspace(-2.1, 2.1, 14), 0.1, 0.02
# Signs must reduce the squared error of an unsigned torque by this factor, and each
# sign must occur in this share of the rows. Rows and iterations of the fit of signs;
# initial Coulomb friction, relative to the root mean square of the rigid torque.
SIGN_GAIN, MINORITY, SIGN_ROWS, SIGN_ROUNDS = 2.0, 0.02, 20_000, 50
DRY_STARTS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, np.inf)

# -- likelihood and filter -------------------------------------------------------------

# Entries of all regressors, and least and largest number of rows; more rows cost time
# without adding evidence.
MOST_ENTRIES, LEAST_ROWS, MOST_ROWS = 2_000_000, 200, 600
# Prior relative error of the described bodies, and its factor if they are invented;
# prior standard deviations of friction, rotor and offset, and of offset differences
# between recordings, relative to the torque; most recordings; that of factors.
NOMINAL_ERROR, INVENTED, WIDE, OFFSETS, MANY, FACTOR = 0.5, 8.0, 10.0, 0.3, 20, 1e3
# Largest cost of negative friction per joint [log]; controllers may compensate it.
# Iterations of the noise variances and relative change that ends them; iterations of
# factors and change that ends them [log].
FRICTION, ITERATIONS, CONVERGED, PASSES, SETTLED = 15.0, 20, 1e-2, 6, 0.05
# Least noise variance relative to that of the torque, least variance of a torque
# relative to the largest, and autocorrelation at which residuals are independent.
LEAST_NOISE, LEAST_VARIANCE, INDEPENDENT = 1e-7, 1e-12, 0.05
# Least length of a recording [samples]. A joint is compared if it has this many moving
# rows, and this many per parameter or ENOUGH_ROWS.
MIN_SAMPLES, FEWEST_ROWS, ROWS_PER_PARAMETER, ENOUGH_ROWS = 64, 70, 2, 120
# The cut-off is this multiple of the frequency that contains 90 % of the velocity's
# power, and at least this many periods per longest recording. The cut-off of the states
# is at least the last multiple of that frequency. Largest frequency of a joint relative
# to the median joint.
CUTOFF_PER_BANDWIDTH, CUTOFF_PERIODS, SMOOTH, BANDWIDTHS = 9.0, 36.0, 5.5, 10.0
# A joint is at rest below this share of its 99.5 % quantile of speed.
# Least moving share of the filter window in rows that count as moving, or throughout.
STANDSTILL, MOVING, THROUGHOUT = 0.02, 0.9, 0.98

# -- rows ------------------------------------------------------------------------------

# The mean squared step of shuffled rows is twice the variance; 0.7 of that is a
# correlation of 0.3. Only joints with this standard deviation count [rad or m]; a joint
# is at rest if its range is below this many deviations of its noise.
# Least number of rows in which the order is tested.
SHUFFLED, LEAST_MOTION, STILL_TRAVEL, SHORT_RUN = 0.7, 0.01, 12.0, 16
# A jump is a full turn up to the first fraction of a turn, and an overflow of a torque
# if the median jump is its range up to the second one.
TURN_LEFT, EDGE = 0.15, 0.05
# Least number and share of repeated rows that are reported, and that are a warning.
# Gaps of missing rows are this many times as frequent as other changes of the steps.
FEWEST_REPEATED, REPEATED_SHARE, MANY_REPEATED, CLEARLY_MISSING = 3, 0.002, 0.1, 2.0
# The logger was frozen if this many rows are equal and a joint moves at this share of
# its usual step over this many samples before and after them.
FROZEN_ROWS, HELD_SPEED, NEAR_ROWS = 5, 0.1, 3
# A torque is coarse if its quantisation error exceeds this share of its standard
# deviation, a warning if its range has fewer levels than this, zero below this [N m or
# N], and constant if its range is below this share of its maximum.
COARSE, LEVELS, ZERO, ROUNDING = 0.05, 5, 1e-9, 1e-12
# Clipping: samples within this share of the range of an extreme value, in runs of this
# length, this many times (or one run of the long length, in a channel that rarely
# repeats a value), and denser by this factor than torques next to the extreme value
# (3.4 for a sine without noise).
PLATEAU, PLATEAU_RUN, PLATEAU_RUNS, LONG_PLATEAU, DENSITY = 1e-3, 5, 3, 12, 8.0
AVERAGED = 15  # rows over which the noise of a plateau is averaged
# Clipped samples are a warning from this share on: on simulated arms, 0.3 % of them
# raise the error of a joint by at most 3 %, and 1 % of them by up to 70 %.
MANY_CLIPPED = 0.005
# Constant torques are dropouts if the jumps before and after exceed this many usual
# steps and this share of the standard deviation, this many times.
DROPOUT_STEP, LEAST_DROPOUT, DROPOUT_RUNS = 4.0, 0.05, 3
# A torque is stuck if it is constant for this many samples (for this time [s] if its
# joint was at rest before) and repeats at most this share of the other samples.
STUCK_RUN, ARRIVES, STUCK_REPEATS = 50, 0.1, 0.1
# Drives are off if no torque exceeds this share of its root mean square although the
# weight exceeds the second share.
OFF_SHARE, OFF_LOAD = 0.05, 0.2
# A position is constant if over this many samples its range is below this share of its
# 99 % quantile. A stop is abrupt if it exceeds this many times this quantile of the
# acceleration. Such stops are more than a note above this share of samples.
LEAST_STOP, STOP_RANGE, SUDDEN, USUAL, STUCK_SHARE = 10, 3e-3, 3.5, 0.99, 0.03
# An encoder is also stuck if in a run of this many samples this share equals the sample
# before, although its noise is this many times its resolution and less than this share
# of the other samples does.
DEAD_RUN, DEAD_SHARE, DEAD_NOISE, REPEATED = 50, 0.8, 3.0, 0.005
# Outliers: least deviation from the neighbours in robust standard deviations, samples
# of a recording, jump as a share of the channel's range, and largest share of outliers
# (more are noise); length of the median filter of torques [samples]. Torques are also
# outliers beyond the second multiple of the 99 % quantile, if none is between both.
OUTLIER, FEWEST_AROUND, LEAST_JUMP, MOST_OUTLIERS, MEDIAN = 25.0, 16, 0.003, 0.01, 5
BEYOND, FEWEST_STEPS = (3.0, 10.0), 20
# Derivatives among given states are wrong from this factor on.
# Torques are the motion times a factor if they agree to `GOOD_FIT` and the factors of
# all joints to this share (a single torque must equal it to this share). A torque is a
# multiple of another one up to the second share.
RATE, SAME, COPY = 1.5, 0.02, 5e-4

# -- what a motion shows ---------------------------------------------------------------

# A joint has one speed if the central share of its speeds spans less than this share of
# their mean (a uniform distribution then has a standard deviation of a tenth of it).
CENTRAL, ONE_SPEED = 0.8, np.sqrt(12.0) / 10.0
# Least number of reversals that shows friction with memory. Range of positions below
# which position-dependent effects look like a spring [rad].
FEW_REVERSALS, WIDE_RANGE = 10, np.radians(60.0)
