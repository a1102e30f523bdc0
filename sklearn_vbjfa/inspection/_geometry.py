"""Whether channels belong to their joints: order, direction and zero, sign of torques.

A candidate correction is judged by how far it lowers the squared torque errors in
blocks of time that the regressions have not seen.
"""

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from scipy.optimize import linear_sum_assignment

from sklearn_vbjfa.inspection._rivals import (
    FEWEST_ROWS,
    NOMINAL_SHARE,
    SURE,
    ChannelEquations,
    fits_of,
    gain,
    total,
)
from sklearn_vbjfa.model import is_prismatic, joint_names
from sklearn_vbjfa.recording import ChannelFinding, in_order, listed_joints

# Friction below this share of a torque is no evidence of a wrong sign ...
_FRICTION_SHARE = 0.1
# ... and below this none against one.
_CONTRADICTS = 0.02
# A torque does not follow the nominal one if this explains less of it.
_FOLLOWS = 0.1
# With a larger relative error the fit is too poor to judge the friction's sign by.
_WORST_ERROR = 0.3


def torque_signs(model, names, signals):
    """Find torques with the wrong sign; also whether any is seen to be right."""
    # Returns the signals with the signs corrected as well.
    equations = ChannelEquations(model, signals)
    found = []
    sign = np.ones(model.nv)
    right = False
    for j, fit in fits_of(equations, signals).items():
        scale, scale_t, share = equations.nominal_scale(j)
        if fit.error[0] > _WORST_ERROR:
            continue
        # A wrong sign takes stronger evidence than a right one.
        friction = fit.power_t * (fit.friction > _FRICTION_SHARE)
        rigid = scale_t * (share > NOMINAL_SHARE)
        against = max(
            fit.power_t * (fit.friction > _CONTRADICTS),
            scale_t * (share > 0.5 * NOMINAL_SHARE),
        )
        if min(friction, rigid) > -SURE or against > 2.0:
            right |= max(friction, rigid) > SURE
            continue
        sign[j] = -1.0
        evidence = []
        if friction < -SURE:
            evidence.append(
                f"friction would feed {-fit.power:.3g} W into the motion "
                f"({-fit.power_t:.0f} standard errors)"
            )
        if rigid < -SURE:
            evidence.append(
                f"it follows {scale:.2g} times the model's torque "
                f"({-scale_t:.0f} standard errors)"
            )
        # A channel that follows the model's torque with neither sign may hold the
        # friction compensation of a controller.
        follows = rigid < -SURE or scale_t == 0.0
        found.append(
            ChannelFinding(
                "torque_sign",
                (j,),
                "error" if follows or share > _FOLLOWS else "doubt",
                f"The torque of {names[j]} has the wrong sign: "
                f"{' and '.join(evidence)}; multiply it by -1.",
            )
        )
    if found and not right:
        # What follows is asked as `unseen_signs` will conclude.
        sign[:] = -1.0
    return found, right, signals.signed(sign)


def unseen_signs(names, findings):
    """Conclude on the signs that nothing shows: one finding or none."""
    # A log whose torques all have the other sign is likelier than one in which just
    # those are right that cannot be seen.
    wrong = [one for one in findings if one.kind == "torque_sign"]
    seen = {j for one in wrong for j in one.joints}
    unseen = tuple(j for j in range(len(names)) if j not in seen)
    if not wrong or not unseen:
        return []
    return [
        ChannelFinding(
            "torque_sign",
            unseen,
            in_order(wrong)[0].severity,
            f"The sign of the torque of {listed_joints(names, unseen)} cannot be seen "
            "in this motion; as all that can be seen are wrong, multiply it by -1 too.",
        )
    ]


# Swapping two channels must lower the squared errors of both by this factor.
_SWAP_GAIN = np.log(4.0)
# Another zero, of which many are tried, must lower those of all joints by this.
_ZERO_GAIN = np.log(2.0)
# Nothing is looked for if all joints have at most this relative error.
_GOOD_FIT = 0.1
# Gain over all joints that each swap on the way to another order must bring.
_CLIMB = 0.05
# All orders of up to this many joints are tried if half of the joints have errors above
# this: single swaps help little before most joints are in place.
_MOST_ORDERS = 5
_NO_FIT = 0.5
# Rows with which other orders, directions and zeros are tried, which is expensive.
_TRIAL_ROWS = 700
# Exchanges of two channels that are tried for each joint, the likeliest ones: all of
# them up to seven joints. A joint has few neighbours that it can be mistaken for, while
# the pairs grow with the square of the joints.
_PAIRS_PER_JOINT = 3
# Places by which all columns may be shifted, to either side: as many as columns that
# do not belong to a joint may stand before the first one. All up to seven joints.
_MOST_ROLLED = 3
# Offsets of a joint's zero that are tried [rad].
_OFFSETS = np.deg2rad([-135, -90, -45, 45, 90, 135, 180])


def misplaced(model, names, signals):
    """Find swapped channels, reversed joints and wrong zeros, the worst fault first."""
    # Also returns the signals with these faults corrected.
    found = []
    for _ in range(model.nv):
        best = _best(model, signals)
        if best is None:
            break
        signals = best.put_right(signals)
        found.append(best)
    return [_finding(names, correction) for correction in _joined(found)], signals


@dataclass(frozen=True, kw_only=True)
class Correction:
    """Another reading of some channels."""

    kind: str  # of the finding
    joints: tuple
    order: np.ndarray | None = None  # (nv,) or None: channel to read for each joint
    sign: np.ndarray | None = None  # (nv,) or None: directions of joints
    # (nv,) or None: offsets to add to the positions [rad]
    offset: np.ndarray | None = None
    # logarithm of the factor by which the squared errors of these joints fall
    gain: float = 0.0
    gain_t: float = 0.0  # the same in standard errors

    def put_right(self, signals):
        """Return the corrected signals."""
        if self.order is not None:
            signals = signals.permuted(
                self.order,
                positions=self.kind != "swapped_torques",
                torques=self.kind != "swapped_positions",
            )
        if self.sign is not None:
            signals = signals.flipped(self.sign)
        if self.offset is not None:
            signals = signals.shifted(self.offset)
        return signals


def _best(model, signals):
    """Return the correction that helps most, or None."""
    equations = ChannelEquations(model, signals)
    fits = fits_of(equations, signals)
    if not fits or all(fit.error[0] < _GOOD_FIT for fit in fits.values()):
        return None
    candidates = []
    best = _torque_order(model.nv, equations, signals, sorted(fits))
    if best is not None:
        candidates.append(best)
        right = best.put_right(signals)
        again = {j: equations.fit(j, right.now[:, [j]]) for j in fits}
        if all(fit.error[0] < _GOOD_FIT for fit in again.values()):
            return best
    few = signals.thinned(_TRIAL_ROWS)
    # A joint that moves only in a small part of the recording has too few rows left.
    told = few.informative()
    joints = [j for j in sorted(fits) if told[j]]
    if not joints:
        return best
    trial = _Trial(model, few, joints)
    candidates += trial.orders() + trial.directions() + trial.zeros()
    return max(candidates, key=lambda c: c.gain, default=None)


def _torque_order(nv, equations, signals, joints):
    """Look for torques that fit other joints better than their own."""
    if len(joints) < 2:
        return None
    logs = {}
    pairs = _likely(equations, signals, joints)
    wanted = {*pairs, *(pair[::-1] for pair in pairs), *((j, j) for j in joints)}
    for a in joints:
        for b in joints:
            if (a, b) not in wanted:
                continue
            weight = signals.weight[:, a] * signals.weight[:, b]
            if weight.sum() >= FEWEST_ROWS:
                logs[a, b] = [
                    equations.fit(a, signals.now[:, [k]], weight).log_error[:, 0]
                    for k in (b, a)
                ]
    size = len(joints)
    cost = np.full((size, size), 1e3)
    for (a, b), (crossed, _) in logs.items():
        # Relative to the torque's own place, so that large torques do not decide.
        own = logs[b, b][0] if (b, b) in logs else crossed
        cost[joints.index(a), joints.index(b)] = -gain(crossed, own)[0]
    rows, columns = linear_sum_assignment(cost)
    order = np.arange(nv)
    order[np.array(joints)[rows]] = np.array(joints)[columns]
    candidates = [order]
    for pair in pairs:
        other = np.arange(nv)
        other[list(pair)] = pair[::-1]
        candidates.append(other)
    found = []
    for order in candidates:
        moved = [j for j in joints if order[j] != j]
        if not moved or any((j, order[j]) not in logs for j in moved):
            continue
        # Each torque must fit its new joint better than its old one.
        each = [gain(logs[j, order[j]][0], logs[order[j], j][1]) for j in moved]
        better, better_t = gain(
            np.mean([logs[j, order[j]][0] for j in moved], axis=0),
            np.mean([logs[order[j], j][1] for j in moved], axis=0),
        )
        if better > _SWAP_GAIN and better_t > SURE and min(x for x, _ in each) > 0:
            found.append(
                Correction(
                    kind="swapped_torques",
                    joints=tuple(int(j) for j in moved),
                    order=order,
                    gain=better,
                    gain_t=better_t,
                )
            )
    # By the sum over the joints, since each pair of a longer cycle helps a little, too.
    return max(found, key=lambda c: c.gain * len(c.joints), default=None)


def _likely(equations, signals, joints):
    """Pairs of joints whose torques, or positions, may be exchanged."""
    # All pairs if there are few; else those in which the torque of each joint follows
    # the motion of the other best, compared with how it follows its own: of all
    # torques in the equation of each joint, which has to be factorised only once for
    # them.
    pairs = list(combinations(joints, 2))
    most = _PAIRS_PER_JOINT * len(joints)
    if len(pairs) <= most:
        return pairs
    torque = signals.now[:, joints]
    size = torque.std(axis=0)
    torque = torque / np.where(size > 0, size, 1.0)
    error = np.array(
        [np.nanmean(equations.fit(j, torque).log_error, axis=0) for j in joints]
    )
    own = np.diagonal(error)
    crossed = error + error.T - own - own[:, None]
    cost = [crossed[joints.index(a), joints.index(b)] for a, b in pairs]
    return [pairs[k] for k in np.argsort(cost, kind="stable")[:most]]


def _worst(fits):
    """Pairs of joints both of which fit poorly, all pairs if there are few."""
    # A joint that stands in the wrong place fits worse than what it is read for: an
    # exchange can lower the squared errors of both only as far as they are large.
    pairs = list(combinations(fits, 2))
    cost = [-min(fits[a].error[0], fits[b].error[0]) for a, b in pairs]
    most = _PAIRS_PER_JOINT * len(fits)
    if len(pairs) <= most:
        return pairs
    return [pairs[k] for k in np.argsort(cost, kind="stable")[:most]]


def _reads(model):
    """Joints whose motion enters each joint's torque: those on a chain with it."""
    reads = []
    for j in range(model.nv):
        bodies = model.subtrees[j + 1]
        on = set().union(*(model.supports[i] for i in bodies)) - {0}
        reads.append(sorted(i - 1 for i in on))
    return reads


class _Trial:
    """Corrections that change the motion of the model, tried on a few rows."""

    # A torque depends on the motion of the joints on a chain with its own alone, so
    # that a correction on one branch leaves the fits of the others as they are; none is
    # made twice.

    def __init__(self, model, signals, joints):
        self._model, self._signals, self._joints = model, signals, joints
        self._names, self._reads = joint_names(model), _reads(model)
        equations = ChannelEquations(model, signals)
        self._features = equations.features
        self._known = {ChannelEquations.fit: {}, ChannelEquations.least_errors: {}}
        fits = self._errors(Correction(joints=(), kind="as recorded"))
        self._now = total(fits)
        errors = [fit.error[0] for fit in fits.values()]
        self._lost = np.median(errors) > _NO_FIT
        self._likely = _likely(equations, signals, joints)
        self._poor = _worst(fits)

    def _errors(self, correction, how=ChannelEquations.fit):
        """Errors of all informative joints with a correction, joint -> of each."""
        # how: method of `ChannelEquations`, `fit` or `least_errors`.
        signals = correction.put_right(self._signals)
        readings = self._readings(correction)
        # Fits that were made already are the best of bounds.
        known = self._known[how] | self._known[ChannelEquations.fit]
        told = np.flatnonzero(signals.informative())
        new = [j for j in told if readings[j] not in known]
        if new:
            equations = ChannelEquations(self._model, signals, self._features)
            made = {readings[j]: how(equations, j, signals.now[:, [j]]) for j in new}
            self._known[how].update(made)
            known.update(made)
        return {int(j): known[readings[j]] for j in told}

    def _readings(self, correction):
        """Return what each joint's fit depends on, list of tuple."""
        nv = self._model.nv
        same, ones, none = np.arange(nv), np.ones(nv), np.zeros(nv)
        order = same if correction.order is None else correction.order
        position = same if correction.kind == "swapped_torques" else order
        torque = same if correction.kind == "swapped_positions" else order
        sign = ones if correction.sign is None else correction.sign
        offset = none if correction.offset is None else correction.offset
        motion = list(zip(position.tolist(), sign.tolist(), offset.tolist()))
        return [
            (j, int(torque[j]), *(motion[k] for k in self._reads[j])) for j in range(nv)
        ]

    def _gain(self, correction, least):
        """Gain over all joints, also in standard errors."""
        # Zero if too few rows count, or if it cannot be `least` whatever the fits are.
        for how in (ChannelEquations.least_errors, ChannelEquations.fit):
            errors = self._errors(correction, how)
            if len(errors) < len(self._joints):
                return 0.0, 0.0
            found = gain(total(errors), self._now)
            if found[0] < least:
                return 0.0, 0.0
        return found

    def _judge(self, moved, least=0.0, **how):
        """Return the correction if it is certain and gains `least` over all joints."""
        # From the mean over all joints to that over the joints concerned.
        share = self._model.nv / max(len(moved), 2)
        least = max(least, _SWAP_GAIN / share)
        better, better_t = self._gain(Correction(joints=moved, **how), least)
        if not (share * better > _SWAP_GAIN and better_t > SURE):
            return None
        return Correction(joints=moved, gain=share * better, gain_t=better_t, **how)

    def orders(self):
        """Swap the positions of two joints, or reorder whole joints."""
        nv, prismatic = self._model.nv, is_prismatic(self._model)
        found = []
        for pair in self._likely:
            if prismatic[pair[0]] == prismatic[pair[1]]:
                order = _exchanged(np.arange(nv), pair)
                found.append(self._judge(pair, kind="swapped_positions", order=order))
        if len(self._joints) > 1:
            order = self._best_order()
            moved = tuple(int(j) for j in np.flatnonzero(order != np.arange(nv)))
            if moved:
                found.append(self._judge(moved, kind="swapped_joints", order=order))
        return [c for c in found if c is not None]

    def _best_order(self):
        """Best order found by swaps from the best of plain orders, (nv,) of int."""
        nv = self._model.nv
        rolls = {k % nv for k in range(-_MOST_ROLLED, _MOST_ROLLED + 1)}
        starts = [np.roll(np.arange(nv), k) for k in sorted(rolls)]
        starts.append(np.arange(nv)[::-1])
        # Programs that do not know the order of the joints sort them by name.
        named = np.argsort(self._names, kind="stable")
        starts += [named, np.argsort(named)]
        if self._lost and nv <= _MOST_ORDERS:
            starts = [np.array(order) for order in permutations(range(nv))]
        best, order = self._highest(starts, 0.0, np.arange(nv))
        # Each swap puts at least one joint in its place.
        for _ in range(nv):
            tried = [_exchanged(order, pair) for pair in self._poor]
            better, other = self._highest(tried, best + _CLIMB, None)
            if other is None:
                break
            best, order = better, other
        return order

    def _highest(self, orders, best, order):
        """Gain over all joints and order of the best of `orders`, or of what it has."""
        for other in orders:
            if (other == np.arange(other.size)).all():
                continue
            tried = Correction(joints=(), kind="swapped_joints", order=other)
            better, _ = self._gain(tried, best)
            if better > best:
                best, order = better, other
        return best, order

    def directions(self):
        """Reverse single joints."""
        found = []
        for j in self._joints:
            sign = np.ones(self._model.nv)
            sign[j] = -1.0
            found.append(self._judge((j,), kind="flipped_joint", sign=sign))
        return [c for c in found if c is not None]

    def zeros(self):
        """Shift the zeros of single revolute joints."""
        found = []
        for j in np.flatnonzero(~is_prismatic(self._model)):
            for angle in _OFFSETS:
                offset = np.zeros(self._model.nv)
                offset[j] = angle
                found.append(
                    self._judge(
                        (int(j),), _ZERO_GAIN, kind="position_zero", offset=offset
                    )
                )
        return [c for c in found if c is not None]


def _exchanged(order, pair):
    order = order.copy()
    order[list(pair)] = order[list(pair[::-1])]
    return order


def _joined(found):
    """Join successive reorderings that share a joint."""
    out = []
    for correction in found:
        last = out[-1] if out else None
        if (
            last is not None
            and last.order is not None
            and correction.order is not None
            and last.kind == correction.kind
            and set(last.joints) & set(correction.joints)
        ):
            order = last.order[correction.order]
            moved = np.flatnonzero(order != np.arange(order.size))
            out[-1] = Correction(
                kind=last.kind,
                joints=tuple(int(j) for j in moved),
                order=order,
                gain=last.gain + correction.gain,
                gain_t=min(last.gain_t, correction.gain_t),
            )
        else:
            out.append(correction)
    return out


def _finding(names, correction):
    joints = correction.joints
    evidence = (
        f"the squared torque errors fall by the factor {np.exp(correction.gain):.3g} "
        f"({correction.gain_t:.0f} standard errors)"
    )
    if correction.offset is not None:
        angle = np.rad2deg(correction.offset[joints[0]])
        message = (
            f"The zero of {names[joints[0]]} looks off by about {-angle:.0f} degrees: "
            f"with {angle:+.0f} degrees added to its position {evidence}; put the zero "
            "where the model has it, or, if the robot is mounted in another way or "
            "carries a tool, say so in the model."
        )
        # A doubt: another mounting or tool looks the same, with a wrong geometry only.
        return ChannelFinding("position_zero", joints, "doubt", message)
    if correction.sign is not None:
        message = (
            f"{names[joints[0]]} turns the other way round in the recording than in "
            f"the model: with both its position and its torque times -1 {evidence}; "
            "multiply both columns by -1, or turn the axis in the model."
        )
        return ChannelFinding("flipped_joint", joints, "error", message)
    what = {
        "swapped_torques": "torques",
        "swapped_positions": "positions",
        "swapped_joints": "positions and torques",
    }[correction.kind]
    # If friction is the only evidence, the two cannot be told apart.
    other = {"torques": " (or their positions)", "positions": " (or their torques)"}
    if len(joints) == 2:
        message = (
            f"The {what} of {names[joints[0]]} and {names[joints[1]]} look exchanged"
            f"{other.get(what, '')}: the other way round {evidence}; exchange the "
            "columns."
        )
        return ChannelFinding(correction.kind, joints, "error", message)
    order = ", ".join(names[k] for k in np.argsort(correction.order))
    message = (
        f"The columns of {what} are in another order{other.get(what, '')}: read as "
        f"{order} {evidence}; put them into the order of the model, "
        f"{', '.join(names)}."
    )
    return ChannelFinding("joint_order", joints, "error", message)
