"""The search for effects that a model lacks: add, refine, prune, replace."""

from dataclasses import dataclass, field

import numpy as np
from scipy import optimize
from sklearn.base import clone

from sklearn_vbjfa.diagnosis._candidates import Candidate, Step, closure
from sklearn_vbjfa.diagnosis._evidence import compare, no_worse
from sklearn_vbjfa.diagnosis._regression import BlockRegression
from sklearn_vbjfa.diagnosis._transfer import Transfer

# A joint whose out-of-sample error is within this factor of its noise floor lacks
# nothing that could be named.
AT_FLOOR = 1.15
# An effect stays as long as leaving it out would cost this share of the error.
_SUPERFLUOUS = 0.01
# What is found must hold beyond the data that it was found in: fitted to this first
# share of the blocks it is tried on the rest.
_FORWARD = 0.75
_MUCH = 0.25
# A plain effect that saves this share of what one that contains it saves goes first.
_CONTAINED = 0.5
# Effects of one kind on one joint, with different settings (drift of this and that).
_MOST_ROUNDS_PER_JOINT = 6


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

    # -- models ---------------------------------------------------------------------

    def regression(self, effects):
        """Regression of the declared model with some effects."""
        view = self.view
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
            view.ridge,
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

    @property
    def level(self):
        """Level of one test, all candidates and joints considered (Bonferroni)."""
        return self.alpha / max(len(self.library) * self.view.nv, 1)

    # -- one round ------------------------------------------------------------------

    def score(self, effect, base, before, accepted):
        """Try an effect of the library beside a model; None if there is nothing new."""
        variants, columns = self.view.family(effect, self.motion)
        taken = {e.key() for e in accepted} | set(self._refused)
        keep = [i for i, v in enumerate(variants) if v.key() not in taken]
        if not keep:
            return None
        if len(keep) < len(variants):
            variants, columns = [variants[i] for i in keep], columns[:, :, keep]
        joints = self.view.joints_of(effect)
        score = base.score(joints, columns)
        if not variants[score.best].plausible(score.coef):
            return None
        evidence = compare(*self._relevant(effect, before, score.squares))
        return Candidate(
            effect=variants[score.best],
            evidence=evidence,
            squares=score.squares,
            coef=score.coef,
            outside=score.outside,
        )

    def _relevant(self, effect, *squares):
        """Squared errors of the joint, or of the whole robot in units of noise."""
        if effect.whole_robot:
            return [s @ self.view.precision for s in squares]
        return [s[:, effect.joint] for s in squares]

    def try_joint(self, joint, base, before, accepted, quiet=False):
        """Try all effects on a joint, name -> Candidate, the plainer first.

        A quiet joint lacks nothing of its own, but may be where something acts that
        others feel.
        """
        everything = self.candidates_of(joint)
        if quiet:
            everything = [effect for effect in everything if effect.whole_robot]
        tried = {}
        for effect in sorted(everything, key=lambda e: len(closure(e, everything))):
            candidate = self.score(effect, base, before, accepted)
            if candidate is not None:
                tried[effect.name] = candidate
        return tried

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
            id(c): c.squares @ self.view.precision if whole else c.squares[:, joint]
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
        self._refused, self.threshold = set(), self.level
        self._refresh()
        for number in range(_MOST_ROUNDS_PER_JOINT * self.view.nv):
            if self.max_effects is not None and len(self.accepted) >= self.max_effects:
                break
            if not self._round(number):
                break
        self._polish()
        self._withdraw()
        return self

    def _round(self, number):
        quiet = self.at_floor(self.before) | (self.view.precision == 0)
        tried = {}
        for joint in range(self.view.nv):
            self._say(number, f"joint {joint + 1} of {self.view.nv}")
            if self.view.precision[joint] > 0 and not quiet.all():
                tried[joint] = self.try_joint(
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
        if not self._holds_later(effect, chosen.evidence.gain):
            self._refused.add(effect.key())
            self._record(
                "refuse", effect, None, chosen.evidence, rivals, found, self.before
            )
            return True
        before = self.before
        self.accepted.append(effect)
        self._refused.clear()
        self._refresh()
        self._record("add", effect, None, chosen.evidence, rivals, found, before)
        self._prune(effect)
        self._retune(effect.joint)
        self._replace(effect.joint)
        return True

    def _holds_later(self, effect, gain):
        """Whether an effect fitted to the first part of the data helps in the last."""
        border = int(_FORWARD * self.view.blocks.n_blocks)
        first = self.view.blocks.label < border
        columns = self.view.columns([effect], self.motion)
        begun = columns[:, first].any(axis=(0, 2, 3))
        if begun.sum() < 0.5 * first.sum():
            return True  # begins late (a payload): too little to fit it to
        with_it = self.regression([*self.accepted, effect]).forward_squares(border)
        without = self.base.forward_squares(border)
        case = compare(*self._relevant(effect, without, with_it))
        if effect.slow:
            # Whatever changes slowly can be fitted by a function of time.
            return case.gain > 0 and case.p_value < self.alpha
        # An effect that explains much may do badly before others are there, too.
        return case.gain > -case.gain_std or gain > _MUCH

    def _weighted_gain(self, candidate):
        """Fall of the robot's log-likelihood-like error, to compare joints."""
        rows = (self.view.root.T**2).sum(axis=1)
        before, after = self.before.sum(axis=0), candidate.squares.sum(axis=0)
        used = (before > 0) & (after > 0)
        return float((rows[used] * np.log(before[used] / after[used])).sum())

    def _record(self, action, effect, replaced, evidence, rivals, tried, before):
        order = sorted(tried, key=lambda c: -c.evidence.gain)
        self.steps.append(
            Step(
                action=action,
                effect=effect,
                replaced=replaced,
                evidence=evidence,
                rivals=tuple(rivals),
                tried=tuple(order),
                squares_before=before.sum(axis=0),
                squares_after=self.before.sum(axis=0),
            )
        )

    def _prune(self, newest):
        """Drop what became superfluous or took a wrong sign, the least useful first."""
        while True:
            worst, evidence = None, None
            for effect in self.accepted:
                if effect is newest:
                    continue
                rest = [e for e in self.accepted if e is not effect]
                without = self.regression(rest).squares()
                case = compare(*self._relevant(effect, without, self.before))
                natural = effect.natural(self.coefficients(effect))
                if natural and case.significant(self.alpha, _SUPERFLUOUS):
                    continue
                if evidence is None or case.gain < evidence.gain:
                    worst, evidence = effect, case
            if worst is None:
                return
            before = self.before
            self.accepted = [e for e in self.accepted if e is not worst]
            self._refresh()
            self._record("drop", worst, None, evidence, (), (), before)

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
            self._record("withdraw", worst, None, evidence, (), (), before)

    def _replace(self, joint):
        """Let rivals compete for the place of each effect of the joint."""
        for effect in [e for e in self.accepted if e.joint == joint]:
            rest = [e for e in self.accepted if e is not effect]
            base = self.regression(rest)
            before = base.squares()
            tried = self.try_joint(joint, base, before, rest)
            found, others = self.eligible(tried, joint, rest)
            if not found:
                continue
            best, rivals = self.best_of(found, others)
            if best.effect.key() == effect.key():
                continue
            case = compare(*self._relevant(best.effect, self.before, best.squares))
            simpler = best.effect.complexity < effect.complexity
            if case.significant(self.alpha) or (simpler and case.gain > 0):
                refined = self.refine(best.effect, base)
                old = self.before
                self.accepted = [*rest, refined]
                self._refresh()
                self._record("replace", refined, effect, case, rivals, others, old)

    def coefficients(self, effect):
        """Coefficients of an accepted effect in the present model."""
        at = self.view.Z.shape[2]
        for one, scale in zip(self.accepted, self._base_scales):
            if one is effect:
                return self.base.theta[at : at + scale.size] * scale
            at += scale.size
        raise ValueError(f"{effect} is not among the accepted effects.")

    # -- shape parameters -------------------------------------------------------------

    def refine(self, effect, base):
        """Continue the search of the shape parameters between the grid's points."""
        for name in effect.continuous:
            around = self._neighbours(effect, name)
            if around is None:
                continue
            low, high, logarithmic = around

            def cost(u, name=name, effect=effect, logarithmic=logarithmic):
                value = float(np.exp(u) if logarithmic else u)
                trial = clone(effect).set_params(**{name: value})
                columns = self.view.columns([trial], self.motion)
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
            variants, columns = self.view.family(effect, self.motion)
            same = [k for k, v in enumerate(variants) if v.key() == effect.key()]
            if not same:
                continue
            base = self.regression([e for e in self.accepted if e is not effect])
            score = base.score(self.view.joints_of(effect), columns[:, :, same])
            own = self.view.columns([effect], self.motion)
            if score.drop.max() > base.drop(self.view.joints_of(effect), own):
                effect = variants[same[score.best]]
            self.accepted[i] = self.refine(effect, base)
            changed = True
        if changed:
            self._refresh()

    def _polish(self):
        """Tune all shapes once more beside each other, and prune once more."""
        for joint in sorted({e.joint for e in self.accepted}):
            self._retune(joint)
        self._prune(None)

    def _say(self, number, text):
        if self.on_progress is not None:
            self.on_progress(number, text)
