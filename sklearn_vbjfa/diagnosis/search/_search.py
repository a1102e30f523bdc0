"""The search for effects that a model lacks: add, refine, prune, replace.

What effects found in some stretches of motion are worth on the others.

Blocks that alternate between fitting and judging tell effects from noise, but each of
them lies between neighbours that were fitted. What a shape fits to the motion at hand
and to no other shows only where long stretches are left out. There a regression without
constraints extrapolates its own noise, which hides everything else; the physically
consistent one does not.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._evidence import (
    SMALLEST_GAIN,
    Candidate,
    Rule,
    Step,
    closure,
    compare,
    no_worse,
)
from sklearn_vbjfa.diagnosis.search._regression import BlockRegression, Judge
from sklearn_vbjfa.robot._equations import unexcited_entries
from sklearn_vbjfa.robot._estimate import estimate, project
from sklearn_vbjfa.robot._joint_moments import joint_moments

# Stretches that are left out in turn.
_STRETCHES = 3


def stretches(blocks, recording):
    """Return the stretch of each row: every recording's first third, second, last.

    What only one recording has (a payload, a warm start) is known from its other
    thirds.

    Parameters
    ----------
    blocks : Blocks
        Blocks of time, of which none is cut in two.
    recording : ndarray of shape (m,)
        Recording of each row.
    """
    label = np.empty(blocks.label.size, dtype=int)
    for number in np.unique(recording):
        rows = np.flatnonzero(recording == number)
        own, place = np.unique(blocks.label[rows], return_inverse=True)
        if own.size < _STRETCHES:
            # Too short to be cut: left out as a whole, in turns.
            label[rows] = number % _STRETCHES
            continue
        label[rows] = place * _STRETCHES // own.size
    return label


class Transfer:
    """Errors on stretches of motion that were not fitted.

    Parameters
    ----------
    view : RecordingView
        Recording.
    motion : Motion
        Its signals.
    effects : list of Effect
        All that are to be looked at.
    """

    def __init__(self, view, motion, effects):
        self.view, self.effects = view, list(effects)
        equations = view.equations
        columns = [_by_joint(view, motion, effect) for effect in self.effects]
        Phi = np.concatenate([equations.Phi, *columns], axis=2)
        widths = [equations.Phi.shape[2], *(c.shape[2] for c in columns)]
        self._edges = np.cumsum(widths)
        label = stretches(view.blocks, view.recording)
        self._stats = [
            joint_moments(Phi[rows], equations.tau[rows], equations.weight[rows])
            for rows in (label == k for k in np.unique(label))
        ]

    def squares(self, effects):
        """Squared errors with some of the effects, each stretch fitted to the others.

        Parameters
        ----------
        effects : list of Effect
            Those of `self.effects` that the model has.

        Returns
        -------
        ndarray of shape (n_stretches, nv)
            Weighted sums of squares.
        """
        pieces = [np.arange(self._edges[0])]
        for i, effect in enumerate(self.effects):
            if any(effect is one for one in effects):
                pieces.append(np.arange(self._edges[i], self._edges[i + 1]))
        chosen = np.concatenate(pieces)
        stats = [one.columns(chosen) for one in self._stats]
        out = []
        for k, kept in enumerate(stats):
            others = [one for i, one in enumerate(stats) if i != k]
            theta = self._fit(sum(others[1:], start=others[0]))
            out.append(kept.residual_squares(theta))
        return np.array(out)

    def _fit(self, stats):
        """Physically consistent parameters from statistics."""
        robot = self.view.robot
        stats = stats.zeroed(unexcited_entries(stats, robot.features_.n_parameters_))
        found = estimate(stats, joint_weights=self.view.precision)
        return project(found, robot.projector, robot.features_).theta


def _by_joint(view, motion, effect):
    """Columns of an effect in all joints' equations, (m, nv, k)."""
    columns = view.filtered(effect.columns(motion))
    if effect.whole_robot:
        return columns
    out = np.zeros((columns.shape[0], view.nv, columns.shape[-1]))
    out[:, effect.joint] = columns
    return out


# A joint whose out-of-sample error is within this factor of its noise floor lacks
# nothing that could be named.
AT_FLOOR = 1.15
# An effect stays as long as leaving it out would cost this share of the error.
_SUPERFLUOUS = 0.01
# What is found must hold beyond the data that it was found in: fitted to this first
# share of the blocks it is tried on the rest.
_FORWARD = 0.75
# What begins late is fitted to this first share of where it acts.
_LATE = 0.5
# What changes slowly acts in blocks that have this share of its largest power.
_FADED = 0.01
# Blocks on either side of that border in which it acts, at the least: fewer cannot tell
# it from chance.
_ACTIVE = 3
# A plain effect that saves this share of what one that contains it saves goes first.
_CONTAINED = 0.5
# Times that what is linearised is linearised again.
_TANGENTS = 2
# Shapes between the neighbours of a tuned one, from which each fold takes its own.
_FINER = 9
# Effects of one kind on one joint, with different settings (drift of this and that).
_MOST_ROUNDS_PER_JOINT = 6

# Rules by which a step is taken, as they are reported.
STEP_UP = "Benjamini-Hochberg over the candidates of the round"
CONTAINED = "plainer than a candidate that passed, and saves most of what it does"
LATER = "an effect of time must help on later data"
TOO_LATE = "acts in too few blocks to be tried on later data"
HARM = "does harm on later data, beyond one standard error"
SUPERFLUOUS = "leaving it out costs no more than chance, or less than 1 %"
UNNATURAL = "took a sign that it cannot have"
ELSEWHERE = "does harm on motion that it was not fitted to"
BETTER = "better than what it replaces"
SIMPLER = "simpler than what it replaces, and no worse"


@dataclass
class EffectSearch:
    """Greedy search with pruning, from the statistics of blocks of time.

    Attributes
    ----------
    view : RecordingView
        Recording.
    library : tuple of Effect
        Effects to try, on every joint.
    declared : tuple of str
        Effects that the declared model has on every joint.
    floor : ndarray of shape (nv,)
        Mean square of the residual to expect from noise alone; nan if unknown.
    alpha : float
        Level of significance, over all candidates on all joints.
    max_effects : int or None
        Most effects to accept.
    on_progress : callable or None
        Called with (round, text).
    """

    view: object
    library: tuple
    declared: tuple
    floor: np.ndarray
    alpha: float
    max_effects: int | None = None
    on_progress: object = None
    accepted: list = field(default_factory=list)
    steps: list = field(default_factory=list)
    _kept: dict = field(default_factory=dict)
    # Keys of effects that did not hold on later data: beside the model as it is, and
    # how often.
    _refused: set = field(default_factory=set)
    _refusals: dict = field(default_factory=dict)

    # -- models ---------------------------------------------------------------------

    def regression(self, effects, ridge="view"):
        """Regression of the declared model with some effects.

        Its ridge is that of the model as it is, unless another is given; None chooses
        it by cross-validation.
        """
        view = self.view
        ridge = view.ridge if ridge == "view" else ridge
        Z, self._scales = [view.Z], []
        for effect in effects:
            columns = self._columns_of(effect)
            extra = np.zeros((*view.Z.shape[:2], columns.shape[-1]))
            extra[view.joints_of(effect)] = columns
            power = np.mean(extra**2, axis=(0, 1))
            scale = view.size / np.sqrt(np.where(power > 0, power, 1.0))
            self._scales.append(scale)
            Z.append(extra * scale)
        return BlockRegression(
            np.concatenate(Z, axis=2),
            view.target,
            view.precision,
            view.blocks,
            ridge,
            view.moments,
        )

    def _columns_of(self, effect):
        """Columns of an effect, (nj, m, k); kept until the load is another."""
        key = (effect.name, tuple(effect.get_params().items()))
        motion, columns = self._kept.get(key, (None, None))
        stale = "load" in effect.needs and motion is not self.motion
        if columns is None or stale:
            columns = self.view.columns([effect], self.motion)[:, :, 0]
            self._kept[key] = self.motion, columns
        return columns

    def _refresh(self):
        """Joint weights and load from the model as it is now."""
        view = self.view
        self.motion = view.motion(None)
        if self.accepted:
            self.motion = view.motion(self._theta)
        base = self.regression(self.accepted)
        squares = base.squares().sum(axis=0)
        rows = (view.root.T**2).sum(axis=1)
        used = (rows > 0) & (squares > 0)
        view.precision = np.where(used, rows / np.where(used, squares, 1.0), 0.0)
        view.ridge = None
        base = self.regression(self.accepted)
        view.ridge = base.ridge
        self._theta = base.theta[: view.Z.shape[2]]
        self.motion = view.motion(self._theta)
        self.base = self.regression(self.accepted)
        self._base_scales = self._scales
        self.before = self.base.squares()

    def candidates_of(self, joint):
        """Effects of the library on a joint that can be looked for."""
        found = []
        for effect in self.library:
            if effect.whole_robot and effect.name == "payload":
                if joint != self.view.nv - 1:
                    continue
            one = clone(effect).set_params(joint=joint)
            if effect.name in self.declared or one.applies(self.motion):
                continue
            found.append(one)
        return found

    # -- one round ------------------------------------------------------------------

    def score(self, effect, base, before, accepted):
        """Try an effect of the library beside a model.

        Returns
        -------
        Candidate or None
            None if there is nothing new; its evidence has no p-value yet.
        columns : ndarray of shape (nj, m, c, k) or None
            Columns of the shapes that were tried.
        """
        variants, columns = self.view.family(effect, self.motion)
        taken = {e.key() for e in accepted} | self._refused
        keep = [i for i, v in enumerate(variants) if v.key() not in taken]
        if not keep:
            return None, None
        if len(keep) < len(variants):
            variants, columns = [variants[i] for i in keep], columns[:, :, keep]
        joints = self.view.joints_of(effect)
        score = base.score(joints, columns)
        if not variants[score.best].plausible(score.coef):
            return None, None
        evidence = compare(*self._relevant(effect, before, score.squares))
        candidate = Candidate(
            effect=variants[score.best],
            evidence=replace(evidence, p_value=1.0),
            squares=score.squares,
            white=score.squares * self.view.precision,
            coef=score.coef,
            outside=score.outside,
        )
        return candidate, columns

    def _relevant(self, effect, *squares):
        """Squared errors of the joint, or of the whole robot in units of noise."""
        if effect.whole_robot:
            return [s @ self.view.precision for s in squares]
        return [s[:, effect.joint] for s in squares]

    def try_joint(self, joint, base, before, accepted, quiet=False):
        """Try all effects on a joint, name -> Candidate, the plainer first.

        A quiet joint lacks nothing of its own, but may be where something acts that
        others feel. All are judged on rows from which the memory is taken out that
        the residual has with the best of them.

        Returns
        -------
        tried : dict of str to Candidate
            Candidates.
        judge : Judge or None
            What they were judged by; None if none is worth a name.
        """
        everything = self.candidates_of(joint)
        if quiet:
            everything = [effect for effect in everything if effect.whole_robot]
        tried, columns = {}, {}
        for effect in sorted(everything, key=lambda e: len(closure(e, everything))):
            candidate, own = self.score(effect, base, before, accepted)
            if candidate is not None:
                tried[effect.name], columns[effect.name] = candidate, own
        worth = [n for n, c in tried.items() if c.evidence.gain >= SMALLEST_GAIN]
        if not worth:
            return tried, None
        best = max((tried[name] for name in worth), key=self._weighted_gain_of(before))
        residual = self.regression([*accepted, best.effect]).residuals()
        judge = Judge(self.view, base, residual)
        for name in worth:
            one = tried[name]
            white = judge.score(self.view.joints_of(one.effect), columns[name])
            evidence = self._evidence(
                one.effect, (before, one.squares), (judge.squares, white)
            )
            tried[name] = replace(one, white=white, evidence=evidence)
        return tried, judge

    def _evidence(self, effect, squares, white):
        """Evidence for a change on an effect's joint, p-value from whitened rows.

        Each time that the effect was refused before doubles it.
        """
        if effect.whole_robot:
            white = [s.sum(axis=1) for s in white]
        else:
            white = [s[:, effect.joint] for s in white]
        evidence = compare(*self._relevant(effect, *squares), white=white)
        trials = 2.0 ** self._refusals.get(effect.key(), 0)
        return replace(evidence, p_value=min(1.0, trials * evidence.p_value))

    def evidence_of(self, effect):
        """Evidence for an accepted effect: what leaving it out would cost.

        Its shape is chosen inside each fold, so that what was tuned on all rows is
        not judged on them.
        """
        rest = [e for e in self.accepted if e is not effect]
        base, beside, after = self._in_place(effect, rest)
        residual = self.base.residuals()
        judge = Judge(self.view, base, residual)
        before = judge.squares
        if beside is not base:
            judge = Judge(self.view, beside, residual)
        white = judge.score(self.view.joints_of(effect), self._tuned_family(effect))
        return self._evidence(effect, (base.squares(), after), (before, white))

    def _in_place(self, effect, rest):
        """Score an accepted effect beside the rest, shape chosen inside each fold.

        Returns
        -------
        base : BlockRegression
            The rest with the ridge that suits it.
        beside : BlockRegression
            The same, or with the ridge of the whole model, if the effect does better
            beside that: either may hide the one or the other in the others' span.
        after : ndarray of shape (n_blocks, nv)
            Squared out-of-sample residuals with the effect.
        """
        joints, columns = self.view.joints_of(effect), self._tuned_family(effect)
        models = [self.regression(rest, ridge=ridge) for ridge in (None, "view")]
        scores = [base.score(joints, columns).squares for base in models]
        totals = [(s @ self.view.precision).sum() for s in scores]
        best = int(np.argmin(totals))
        return models[0], models[best], scores[best]

    def _tuned_family(self, effect):
        """Columns of an effect's grid of shapes, finer around the tuned one."""
        if not effect.continuous:
            return self._columns_of(effect)[:, :, None]
        variants, columns = self.view.family(effect, self.motion)
        same = [k for k, v in enumerate(variants) if v.key() == effect.key()]
        around = self._neighbours(effect, effect.continuous[0])
        if not same or around is None:
            own = self._columns_of(effect)[:, :, None]
            return np.concatenate([columns[:, :, same], own], axis=2) if same else own
        low, high, logarithmic = around
        values = np.linspace(low, high, _FINER + 2)[1:-1]
        if logarithmic:
            values = np.exp(values)
        finer = [
            self._columns_of(clone(effect).set_params(**{effect.continuous[0]: value}))
            for value in map(float, values)
        ]
        return np.concatenate([columns[:, :, same], np.stack(finer, axis=2)], axis=2)

    def eligible(self, tried, joint, accepted):
        """Candidates that may be added to a joint, and all that beat chance.

        An effect that contains a plainer one which explains most of what it explains
        itself would win by that alone. The plain one is offered in its place; the
        other may come in a later round, beside it.
        """
        present = set(self.declared) | {e.name for e in accepted if e.joint == joint}
        library = [candidate.effect for candidate in tried.values()]
        significant = [
            c for c in tried.values() if c.evidence.significant(self.threshold)
        ]
        found = {}
        for candidate in significant:
            plain = [
                tried[name]
                for name in closure(candidate.effect, library) - present
                if name in tried
                and tried[name].evidence.significant(self.alpha)
                and tried[name].evidence.gain > _CONTAINED * candidate.evidence.gain
            ]
            offered = max(plain, key=lambda c: c.evidence.gain, default=candidate)
            found[id(offered)] = offered
        return list(found.values()), significant

    def _set_threshold(self, tried):
        """Set the level of this round, after Benjamini and Hochberg.

        On a robot that lacks nothing it is Bonferroni's: one false alarm in 1 / alpha
        recordings. On one that lacks much, a short recording could not reach that
        level for any effect. Only the best effect is added, so that a level that many
        true ones have raised falls again before a false one is the best.
        """
        p_values = np.sort(
            [c.evidence.p_value for t in tried.values() for c in t.values()]
        )
        if p_values.size == 0:
            return
        self.n_tests = p_values.size
        m = p_values.size
        rank = np.arange(1, p_values.size + 1)
        passing = rank[p_values <= self.alpha * rank / m]
        self.threshold = self.alpha / m * max(int(passing.max(initial=1)), 1)

    def best_of(self, candidates, others):
        """Return the simplest of the best, and all that compare with it.

        Parameters
        ----------
        candidates : list of Candidate
            Those that may be added.
        others : list of Candidate
            All that beat chance; those that contain the chosen one and explain no
            more are its rivals as well.
        """
        everything = list({id(c): c for c in [*candidates, *others]}.values())
        whole = any(c.effect.whole_robot for c in everything)
        joint = candidates[0].effect.joint
        error = {
            id(c): c.white.sum(axis=1) if whole else c.white[:, joint]
            for c in everything
        }
        best = min(candidates, key=lambda c: error[id(c)].sum())
        close = [c for c in candidates if no_worse(error[id(best)], error[id(c)])]
        simplest = min(close, key=lambda c: (c.effect.complexity, error[id(c)].sum()))
        rivals = tuple(
            c
            for c in everything
            if c is not simplest and no_worse(error[id(best)], error[id(c)])
        )
        return simplest, rivals

    def at_floor(self, squares):
        """Joints whose error noise alone explains."""
        rows = (self.view.root.T**2).sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = squares.sum(axis=0) / rows
        return mean < AT_FLOOR**2 * self.floor

    def run(self):
        """Search until nothing is significant."""
        self.threshold, self.n_tests = self.alpha, 0
        self._refresh()
        number, most = 0, _MOST_ROUNDS_PER_JOINT * self.view.nv
        found = True
        while found:
            while number < most and not self._is_full() and self._round(number):
                number += 1
            found = False
            if self.accepted:
                self._polish()
                # What was hidden by shapes that were not yet tuned may show now.
                if number < most and not self._is_full():
                    found = self._round(number)
                    number += 1
        self._withdraw()
        return self

    def tuned_on(self, view):
        """Return the accepted effects with shapes that suit another view, in order."""
        other = EffectSearch(
            view=view,
            library=self.library,
            declared=self.declared,
            floor=self.floor,
            alpha=self.alpha,
        )
        if self.accepted:
            # The load of the declared model first, which that of the whole needs.
            other._refresh()
            other.accepted = list(self.accepted)
            other._refresh()
            for i, effect in enumerate(self.accepted):
                rest = [e for e in other.accepted if e is not other.accepted[i]]
                base = other.regression(rest)
                if effect.jumping:
                    # It may lie in a stretch that was not searched.
                    effect = other._tuned_among(effect, base)
                other.accepted[i] = other.refine(effect, base)
            other._refresh()
            for joint in {effect.joint for effect in other.accepted}:
                other._linearise(joint)
        return other.accepted

    def _is_full(self):
        """Whether as many effects are accepted as may be."""
        return self.max_effects is not None and len(self.accepted) >= self.max_effects

    def _round(self, number):
        quiet = self.at_floor(self.before) | (self.view.precision == 0)
        tried = {}
        for joint in range(self.view.nv):
            self._say(number, f"joint {joint + 1} of {self.view.nv}")
            if self.view.precision[joint] > 0 and not quiet.all():
                tried[joint], _ = self.try_joint(
                    joint, self.base, self.before, self.accepted, quiet[joint]
                )
        self._set_threshold(tried)
        offers = []
        for joint, candidates in tried.items():
            found, others = self.eligible(candidates, joint, self.accepted)
            if found:
                chosen, rivals = self.best_of(found, others)
                offers.append((self._weighted_gain(chosen), chosen, rivals, others))
        if not offers:
            return False
        _, chosen, rivals, found = max(offers, key=lambda offer: offer[0])
        effect = self.refine(chosen.effect, self.base)
        case, rule = self._later(effect, self.accepted, self.base)
        if rule is not None:
            self._refuse(effect, case, rivals, found, rule)
            return True
        before, rule = self.before, self._rule(chosen)
        self.accepted.append(effect)
        # Beside another model they may hold.
        self._refused.clear()
        self._refresh()
        self._record("add", effect, None, chosen.evidence, rivals, found, rule, before)
        self._prune(effect)
        self._retune(effect.joint)
        self._replace(effect.joint)
        return True

    def _rule(self, candidate):
        """Rule by which a candidate is added in this round."""
        if candidate.evidence.significant(self.threshold):
            return Rule(name=STEP_UP, level=self.threshold, n_tests=self.n_tests)
        return Rule(name=CONTAINED, level=self.alpha, n_tests=1)

    def _later(self, effect, accepted, base):
        """Try an effect on later data than it was fitted to, beside some others.

        Both models are fitted and judged in rows without the residual's memory: slow
        noise that goes on from where it was would decide otherwise.

        Returns
        -------
        Evidence
            On the later blocks.
        Rule or None
            By which it is refused, if it is.
        """
        view = self.view
        joints, own = view.joints_of(effect), self._columns_of(effect)
        # Of the little that is later, all that is independent has to count.
        blocks = view.blocks.divided(max(1.0 / view.robot.cutoff_, view.step))
        power = blocks.sums((own**2).sum(axis=(0, 2)))
        acts = power > (_FADED * power.max() if effect.slow else 0.0)
        where = np.flatnonzero(acts)
        if where.size < 2 * _ACTIVE:
            nothing = np.zeros(1)
            return compare(nothing, nothing), Rule(name=TOO_LATE)
        border = where[int(_FORWARD * where.size)]
        late = where[0] > 0.5 * border
        if late:
            # It has to be fitted where it acts, and tried there as well.
            border = where[int(_LATE * where.size)]
        judge = Judge(view, base, self.regression([*accepted, effect]).residuals())
        if effect.slow or late:
            early = blocks.label < border
            own = self._columns_of(self._tuned_before(effect, base, early))
        squares = judge.forward(joints, own, blocks, border)
        if effect.slow:
            # Where it has faded it cannot be tried: all it does there is to leave
            # other parameters alone.
            squares = [s[acts[border:]] for s in squares]
        if not effect.whole_robot:
            squares = [s[:, [effect.joint]] for s in squares]
        case = compare(*(s.sum(axis=1) for s in squares))
        if effect.slow or late:
            # Whatever changes slowly can be fitted by a function of time, and
            # whatever happened once by what begins late.
            if case.gain > 0 and case.p_value < self.alpha:
                return case, None
            return case, Rule(name=LATER, level=self.alpha, n_tests=1)
        if case.gain > -case.gain_std:
            return case, None
        return case, Rule(name=HARM)

    def _refuse(self, effect, case, rivals, tried, rule):
        """Note that an effect does not hold; every trial counts, see `_evidence`."""
        self._refused.add(effect.key())
        self._refusals[effect.key()] = self._refusals.get(effect.key(), 0) + 1
        self._record("refuse", effect, None, case, rivals, tried, rule, self.before)

    def _tuned_before(self, effect, base, early):
        """Return the effect with the shape that suits some rows best."""
        variants, columns = self.view.family(effect, self.motion)
        same = [k for k, v in enumerate(variants) if v.key() == effect.key()]
        if not same:
            return effect
        there = BlockRegression(
            base.Z * early[:, None],
            base.y * early,
            base.precision,
            base.blocks,
            base.ridge,
        )
        masked = columns[:, :, same] * early[:, None, None]
        drops = there.score(self.view.joints_of(effect), masked).drop
        return self.refine(variants[same[int(np.argmax(drops))]], there, early)

    def _weighted_gain(self, candidate):
        """Fall of the robot's log-likelihood-like error, to compare joints."""
        return self._weighted_gain_of(self.before)(candidate)

    def _weighted_gain_of(self, before):
        rows = (self.view.root.T**2).sum(axis=1)
        before = before.sum(axis=0)

        def gain(candidate):
            after = candidate.squares.sum(axis=0)
            used = (before > 0) & (after > 0)
            return float((rows[used] * np.log(before[used] / after[used])).sum())

        return gain

    def _record(self, action, effect, replaced, evidence, rivals, tried, rule, before):
        order = sorted(tried, key=lambda c: -c.evidence.gain)
        self.steps.append(
            Step(
                action=action,
                effect=effect,
                replaced=replaced,
                evidence=evidence,
                rivals=tuple(rivals),
                tried=tuple(order),
                rule=rule,
                squares_before=before.sum(axis=0),
                squares_after=self.before.sum(axis=0),
            )
        )

    def _prune(self, newest):
        """Drop what became superfluous or took a wrong sign, the least useful first."""
        while True:
            worst, evidence, rule = None, None, None
            for effect in self.accepted:
                if effect is newest:
                    continue
                case = self.evidence_of(effect)
                natural = effect.natural(self.coefficients(effect))
                if natural and case.significant(self.alpha, _SUPERFLUOUS):
                    continue
                if evidence is None or case.gain < evidence.gain:
                    worst, evidence = effect, case
                    rule = Rule(name=SUPERFLUOUS, level=self.alpha, n_tests=1)
                    if not natural:
                        rule = Rule(name=UNNATURAL)
            if worst is None:
                return
            before = self.before
            self.accepted = [e for e in self.accepted if e is not worst]
            self._refresh()
            self._record("drop", worst, None, evidence, (), (), rule, before)

    def _withdraw(self):
        """Drop what makes the error larger on motion that it was not fitted to."""
        while self.accepted:
            transfer = Transfer(self.view, self.motion, self.accepted)
            with_all, worst, evidence = transfer.squares(self.accepted), None, None
            for effect in self.accepted:
                rest = transfer.squares([e for e in self.accepted if e is not effect])
                case = compare(*self._relevant(effect, rest, with_all))
                # A single stretch that differs from the others decides nothing.
                harmful = case.gain < -case.gain_std
                if harmful and (evidence is None or case.gain < evidence.gain):
                    worst, evidence = effect, case
            if worst is None:
                return
            before = self.before
            self.accepted = [e for e in self.accepted if e is not worst]
            self._refresh()
            rule = Rule(name=ELSEWHERE)
            self._record("withdraw", worst, None, evidence, (), (), rule, before)
            # What only made up for it, or shared its place with it, goes as well.
            self._prune(None)

    def _replace(self, joint):
        """Let rivals compete for the place of each effect of the joint."""
        for effect in [e for e in self.accepted if e.joint == joint]:
            rest = [e for e in self.accepted if e is not effect]
            base, beside, now = self._in_place(effect, rest)
            before = base.squares()
            tried, judge = self.try_joint(joint, base, before, rest)
            found, others = self.eligible(tried, joint, rest)
            if not found:
                continue
            best, rivals = self.best_of(found, others)
            if best.effect.key() == effect.key():
                continue
            if beside is not base:
                judge = Judge(self.view, beside, judge.residual)
            joints, columns = self.view.joints_of(effect), self._tuned_family(effect)
            white = judge.score(joints, columns)
            case = self._evidence(best.effect, (now, best.squares), (white, best.white))
            simpler = best.effect.complexity < effect.complexity
            better = case.significant(self.alpha)
            if better or (simpler and case.gain > 0):
                rule = Rule(name=BETTER, level=self.alpha, n_tests=1)
                if not better:
                    rule = Rule(name=SIMPLER)
                refined = self.refine(best.effect, base)
                later, refusal = self._later(refined, rest, base)
                if refusal is not None:
                    self._refuse(refined, later, rivals, others, refusal)
                    continue
                old = self.before
                self.accepted = [*rest, refined]
                self._refresh()
                self._record(
                    "replace", refined, effect, case, rivals, others, rule, old
                )

    def coefficients(self, effect):
        """Coefficients of an accepted effect in the present model."""
        at = self.view.Z.shape[2]
        for one, scale in zip(self.accepted, self._base_scales):
            if one is effect:
                return self.base.theta[at : at + scale.size] * scale
            at += scale.size
        raise ValueError(f"{effect} is not among the accepted effects.")

    # -- shape parameters -------------------------------------------------------------

    def refine(self, effect, base, rows=None):
        """Continue the search of the shape parameters between the grid's points.

        Of a base with some rows only, `rows` (m,) tells which.
        """
        for name in effect.continuous:
            around = self._neighbours(effect, name)
            if around is None:
                continue
            low, high, logarithmic = around

            def cost(u, name=name, effect=effect, logarithmic=logarithmic):
                value = float(np.exp(u) if logarithmic else u)
                trial = clone(effect).set_params(**{name: value})
                columns = self.view.columns([trial], self.motion)
                if rows is not None:
                    columns *= rows[:, None, None]
                return -base.drop(self.view.joints_of(trial), columns)

            found = optimize.minimize_scalar(
                cost,
                bounds=(low, high),
                method="bounded",
                options={"xatol": 1e-3 * (high - low)},
            )
            start = getattr(effect, name)
            at_start = cost(np.log(start) if logarithmic else start)
            if found.fun < at_start:
                value = float(np.exp(found.x) if logarithmic else found.x)
                effect = clone(effect).set_params(**{name: value})
        return effect

    def _neighbours(self, effect, name):
        """Bounds of a shape parameter: the grid's next points on both sides."""
        same = [
            v
            for v in self.view.family(effect, self.motion)[0]
            if v.key() == effect.key()
        ]
        values = np.unique([getattr(v, name) for v in same])
        values = values[np.sign(values) == np.sign(getattr(effect, name))]
        at = (
            int(np.argmin(np.abs(values - getattr(effect, name))))
            if values.size
            else -1
        )
        if at < 0 or getattr(effect, name) == 0 or values.size < 2:
            return None
        positive = bool((values > 0).all())
        scaled = np.log(values) if positive else values
        low, high = scaled[max(at - 1, 0)], scaled[min(at + 1, values.size - 1)]
        return low, high, positive

    def _retune(self, joint):
        """Search the shapes of a joint's effects again, each beside the others."""
        changed = False
        for i, effect in enumerate(list(self.accepted)):
            if effect.joint != joint or not effect.continuous:
                continue
            base = self.regression([e for e in self.accepted if e is not effect])
            effect = self._tuned_among(effect, base)
            self.accepted[i] = self.refine(effect, base)
            changed = True
        if changed:
            self._refresh()
            self._linearise(joint)

    def _tuned_among(self, effect, base):
        """Return the effect with the shape of the grid that suits best, or its own."""
        variants, columns = self.view.family(effect, self.motion)
        same = [k for k, v in enumerate(variants) if v.key() == effect.key()]
        if not same:
            return effect
        score = base.score(self.view.joints_of(effect), columns[:, :, same])
        own = self.view.columns([effect], self.motion)
        if score.drop.max() > base.drop(self.view.joints_of(effect), own):
            return variants[same[score.best]]
        return effect

    def _linearise(self, joint):
        """Linearise a joint's effects at the coefficients that they have."""
        for _ in range(_TANGENTS):
            changed = False
            for i, effect in enumerate(self.accepted):
                if effect.joint == joint and effect.tangent:
                    self.accepted[i] = effect.at(self.coefficients(effect))
                    changed = True
            if not changed:
                return
            self._refresh()

    def _polish(self):
        """Tune all shapes once more beside each other, and prune once more."""
        for joint in sorted({e.joint for e in self.accepted}):
            self._retune(joint)
        self._prune(None)

    def _say(self, number, text):
        if self.on_progress is not None:
            self.on_progress(number, text)
