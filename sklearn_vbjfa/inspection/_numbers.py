"""Thresholds of the log inspection."""

import numpy as np

# -- hypotheses ------------------------------------------------------------------------

# Log odds of a hypothesis: prior, least reported ones, and difference of two rivals;
# half width of a 90 % interval in standard errors.
PRIOR, DECISIVE, RIVAL, INTERVAL = -np.log(100.0), 5.0, np.log(19.0), 1.645
# Log odds by which a contact, or zeros whose errors fall little, must exceed others.
# Least fall of log squared errors by a change of the whole log, per joint, and of some.
FAR_ODDS, CLEAR, CLEAR_OF_JOINT = 25.0, np.log(2.0), np.log(4.0)
# Relative error of a good fit, and number of changes whose likelihood is computed.
GOOD_FIT, MOST_LIKELY = 0.1, 6
# Rows of the rough score of changes: at least, and times the number of joints; share of
# the square of described torques that another factor costs; largest shift of columns.
LEAST_ROUGH, ROUGH, ROUGH_PRIOR, SHIFTS = 60, 4000, 0.05, 3
# Zeros that are tested [rad], prior deviation of a step, half step of derivatives.
ANGLES = np.radians([-120, -80, -40, 40, 80, 120, 180])
STEP_OF_ZERO, SLOPE = 0.5, 1e-4
# Share of the range within which positions begin at zero; least change of zeros [rad]:
# of all joints, of few in a motion, and of few from poses.
AT_ZERO, LEAST_ZERO, FAR_ZERO, POSED_ZERO = 1e-3, 0.05, 0.3, 0.15
# Relative error below which signs are tested; standard errors of negative friction.
WORST, SIGMAS = 0.3, 5.0
# Least common factor of all torques that is reported; that of a single torque, which
# may be large since a geared rotor may exceed its link, and from poses; of commands.
SCALE, SINGLE, POSED_SCALE, COMMANDED = 2.5, 20.0, 1.2, 10.0
# Multiple of the limits (median) that torques of another unit exceed, and placeholder.
BEYOND_LIMITS, NO_LIMIT = 5.0, 1e6
# Size of a torque of noise against the described one, and its least relative error;
# largest error of torques that were computed.
SILENT, UNRELATED, COMPUTED = 0.1, 0.85, 0.007
# Unexplained share of another robot: median of small torques, or that of some joints.
UNEXPLAINED, UNFOLLOWED = 0.3, 0.65
# Largest factor, with its error, that is zero; least share of the weight on a slide.
NO_WEIGHT, SLIDE_LOAD = 0.5, 0.15
# Least turn of the base [rad] (less is base_tilt), and factor of gravity's magnitude.
TURNED, AS_HEAVY = np.radians(15.0), 1.5
# Usual factors of a wrong period, or their inverses; largest multiple of a speed limit.
PERIODS, PLAUSIBLE = (1e3, 100.0, 10.0, 8.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.0), 2.0
# Speed limits of joints without any [rad/s, m/s], implausible multiple of a limit, and
# samples over which speeds are measured.
FASTEST_TURN, FASTEST_SLIDE, TOO_FAST, SPEED_SAMPLES = 60.0, 10.0, 5.0, 5
# Implausibly low share of the speed limits, at periods above this [s] (dt=0.2 is 5 kHz
# in milliseconds); range of small errors of a period [log].
TOO_SLOW, LONG_PERIOD, NEAR_PERIODS = 0.01, 0.15, (0.01, 0.3)
# Standard errors of a lag, and rise of a joint's log squared error that excludes it (or
# share of the fall); iterations, step that ends them [samples]; low-passes per lag.
LEAST_LAG, HARM, MOVES, SAMPLE, CONSTANTS = 3.0, 0.125, 40, 0.75, (0.7, 1.0, 1.4)
# Longest delay of positions against their commands [s].
# Size of a contact in residual deviations, its least share of the log (denominator),
# and number of possible ends.
LATE_COMMAND, CONTACT, SHORTEST_CONTACT, CONTACT_ENDS = 0.15, 3.0, 20, 80
# Largest turn without limits, excess of degrees over limits, least range of counts.
LARGEST_TURN, FAR_BEYOND, FEWEST_COUNTS = 25.0, 5.0, 25.0
# Factors of positions that are tested, error of a known one, least one of a gear [log].
RATIOS, KNOWN_RATIO, LEAST_GEAR = np.linspace(-2.1, 2.1, 14), 0.1, 0.02
# Gain of signs of an unsigned torque, least share of each sign; rows and iterations of
# their fit, and initial Coulomb friction over the root mean square of the rigid torque.
SIGN_GAIN, MINORITY, SIGN_ROWS, SIGN_ROUNDS = 2.0, 0.02, 20_000, 50
DRY_STARTS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, np.inf)

# -- likelihood and filter -------------------------------------------------------------

# Largest number of entries of all regressors; least and largest number of rows.
MOST_ENTRIES, LEAST_ROWS, MOST_ROWS = 2_000_000, 200, 600
# Prior relative error of the described bodies, its factor if they are invented; prior
# deviations of friction, and of offsets between recordings; most of these; of factors;
# of load-dependent friction.
NOMINAL_ERROR, INVENTED, WIDE, OFFSETS, MANY, FACTOR = 0.5, 8.0, 10.0, 0.3, 20, 1e3
LOSS = 0.2
# Largest cost of negative friction per joint [log], as controllers may compensate it;
# iterations and changes that end them: of noise variances, and of factors [log].
FRICTION, ITERATIONS, CONVERGED, PASSES, SETTLED = 15.0, 20, 1e-2, 6, 0.05
# Least noise and torque variances, relative to the torque and to the largest torque;
# autocorrelation at which residuals are independent.
LEAST_NOISE, LEAST_VARIANCE, INDEPENDENT = 1e-7, 1e-12, 0.05
# Least samples of a recording; least moving rows of a joint, per parameter, or enough.
MIN_SAMPLES, FEWEST_ROWS, ROWS_PER_PARAMETER, ENOUGH_ROWS = 64, 70, 2, 120
# Cut-off as a multiple of the frequency below which is 90 % of the velocity's power,
# least periods per recording, multiple for states; largest over the median frequency.
CUTOFF_PER_BANDWIDTH, CUTOFF_PERIODS, SMOOTH, BANDWIDTHS = 9.0, 36.0, 5.5, 10.0
# Share of the 99.5 % quantile of speed at rest; least moving share of a filter window.
STANDSTILL, MOVING, THROUGHOUT = 0.02, 0.9, 0.98

# -- rows ------------------------------------------------------------------------------

# The mean squared step of shuffled rows is twice the variance; 0.7 of that is a
# correlation of 0.3. Least deviation of a moving joint [rad or m]; range of one at rest
# in deviations of its noise; least rows in which the order is tested.
SHUFFLED, LEAST_MOTION, STILL_TRAVEL, SHORT_RUN = 0.7, 0.01, 12.0, 16
# Tolerance of a full turn, and of the range of a torque that overflows.
TURN_LEFT, EDGE = 0.15, 0.05
# Least number and share of repeated rows, share that is a warning, and number of
# missing rows over other changes of the steps.
FEWEST_REPEATED, REPEATED_SHARE, MANY_REPEATED, CLEARLY_MISSING = 3, 0.002, 0.1, 2.0
# Least equal rows of a frozen logger; least speed before and after, over these rows.
FROZEN_ROWS, HELD_SPEED, NEAR_ROWS = 5, 0.1, 3
# Least quantisation error of a coarse torque over its deviation, levels below which it
# is a warning; largest zero torque [N m or N], and relative range of a constant one.
COARSE, LEVELS, ZERO, ROUNDING = 0.05, 5, 1e-9, 1e-12
# Clipping: share of the range at an extreme value, least length and number of runs (or
# length of one, if values rarely repeat), and density over that of torques next to it
# (3.4 for a sine without noise).
PLATEAU, PLATEAU_RUN, PLATEAU_RUNS, LONG_PLATEAU, DENSITY = 1e-3, 5, 3, 12, 8.0
AVERAGED = 15  # rows over which the noise of a plateau is averaged
# Clipped samples are a warning from this share on: on simulated arms, 0.3 % of them
# raise the error of a joint by at most 3 %, and 1 % of them by up to 70 %.
MANY_CLIPPED = 0.005
# Least jumps around a dropout, in usual steps and deviations, and number of dropouts.
DROPOUT_STEP, LEAST_DROPOUT, DROPOUT_RUNS = 4.0, 0.05, 3
# Samples of a stuck torque, time [s] if its joint was at rest before, and largest share
# of other repeated samples.
STUCK_RUN, ARRIVES, STUCK_REPEATS = 50, 0.1, 0.1
# Largest torque of drives that are off, and least weight, over the root mean square.
OFF_SHARE, OFF_LOAD = 0.05, 0.2
# Samples of a constant position, its range over the 99 % quantile; acceleration of an
# abrupt stop over this quantile; share of samples above which stops are no note.
LEAST_STOP, STOP_RANGE, SUDDEN, USUAL, STUCK_SHARE = 10, 3e-3, 3.5, 0.99, 0.03
# A stuck encoder without a stop: samples, share of them that repeats, noise over the
# resolution, and largest share of others that repeat.
DEAD_RUN, DEAD_SHARE, DEAD_NOISE, REPEATED = 50, 0.8, 3.0, 0.005
# Outliers: least robust deviations, samples of a recording, share of the range, largest
# share of outliers, length of the median filter; multiples of the 99 % quantile between
# and beyond which there are none and outliers; least number of jumps between blocks.
OUTLIER, FEWEST_AROUND, LEAST_JUMP, MOST_OUTLIERS, MEDIAN = 25.0, 16, 0.003, 0.01, 5
BEYOND, FEWEST_STEPS = (3.0, 10.0), 20
# Factor of wrong derivatives; largest difference of the factors of joints whose torques
# are their motion; largest error of a torque that is a multiple of another one.
RATE, SAME, COPY = 1.5, 0.02, 5e-4

# -- what a motion shows ---------------------------------------------------------------

# Central share of the speeds of a joint with one speed, and their span over the mean.
CENTRAL, ONE_SPEED = 0.8, np.sqrt(12.0) / 10.0
# Least reversals for friction with memory, and range for effects of the position [rad].
FEW_REVERSALS, WIDE_RANGE = 10, np.radians(60.0)
