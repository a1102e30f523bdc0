"""Torques of an identified robot: what a prediction needs, wherever it comes from.

A fitted `RobotIdentifier` and a robot that was read from a file predict with the same
`TorquePredictor`, which holds what a fit leaves and no data.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from sklearn.utils.validation import check_array

from sklearn_vbjfa.effects import outside, own_motions
from sklearn_vbjfa.model._loading import is_prismatic, joint_names
from sklearn_vbjfa.model._regressor import rounding_entries
from sklearn_vbjfa.recording._columns import (
    columns_beside,
    positions_in_order,
    torques_in_order,
)
from sklearn_vbjfa.recording._recording import check_clock, check_dt, take_arrays
from sklearn_vbjfa.recording._signals import signals_for
from sklearn_vbjfa.robot._column_powers import ColumnPowers
from sklearn_vbjfa.robot._equations import (
    is_plain,
    motion_of,
    regressor_rows,
)
from sklearn_vbjfa.robot._features import RigidBodyFeatures
from sklearn_vbjfa.robot._plan import Plan
from sklearn_vbjfa.robot._query import Query
from sklearn_vbjfa.robot._ranges import (
    outside_text,
    signals_outside_text,
    warn_outside,
)
from sklearn_vbjfa.robot._recording_checks import check_widths
from sklearn_vbjfa.robot._states import fit_states, smooth_to
from sklearn_vbjfa.robot._time_effects import beyond_text, effect_of_time
from sklearn_vbjfa.simulation import Load, TorqueModel, simulate


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueSpread:
    """How far measured torques may be from predicted ones, in the band of the fit.

    Attributes
    ----------
    covariance : ndarray of shape (p, p)
        Of the parameters; infinite on the diagonal where nothing tells one.
    through : ndarray of shape (nv,)
        Variance of the noise of the positions in the residual [N m or N, squared].
    rest : ndarray of shape (nv,)
        Variance of all else in the residual: noise of torques, what the model lacks.
    """

    covariance: np.ndarray
    through: np.ndarray
    rest: np.ndarray

    @classmethod
    def of_estimate(cls, found):
        """Take what an `Estimate` has; None where its regressor has no covariance."""
        if found.covariance is None:
            return None
        told, moments = np.isfinite(np.diagonal(found.covariance)), found.moments
        known = found.covariance[np.ix_(told, told)]
        through, rest = found.noise()
        # A fit takes part of the noise for its own: residuals of its rows are smaller,
        # in the mean by the variance of what is predicted in them.
        taken = np.einsum("jik,ik->j", moments.G[:, told][:, :, told], known)
        with np.errstate(divide="ignore", invalid="ignore"):
            taken = np.where(moments.n > 0, taken / moments.n, 0.0)
        return cls(
            # Symmetric to the last bit, of which a file holds one half.
            covariance=0.5 * (found.covariance + found.covariance.T),
            through=through**2,
            rest=rest**2 + taken,
        )

    def std(self, rows, *, noiseless):
        """Deviations (n, nv) for `RegressorRows`, with or without noise of positions.

        Infinite where a row asks for a parameter that nothing tells.
        """
        told = np.isfinite(np.diagonal(self.covariance))
        known = self.covariance[np.ix_(told, told)]
        variance = self.rest if noiseless else self.rest + self.through
        made = []
        for Phi in rows.blocks():
            own = Phi[:, :, told]
            spread = np.einsum("njk,njk->nj", own @ known, own) + variance
            asked = (Phi != 0) & ~told & ~_rounding(Phi, rows.n_rigid)
            made.append(np.where(asked.any(axis=2), np.inf, spread))
        return np.sqrt(np.maximum(np.concatenate(made), 0.0))


def _rounding(Phi, n_rigid):
    """Entries (nv, p) of matrices (n, nv, p) that are the rounding of a zero."""
    nv = Phi.shape[1]
    found = np.zeros(Phi.shape[1:], dtype=bool)
    power = (Phi[:, :, :n_rigid] ** 2).sum(axis=0).reshape(nv, nv, -1)
    found[:, :n_rigid] = rounding_entries(power).reshape(nv, -1)
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class TorquePredictor:
    """What an identified robot predicts torques with.

    Attributes
    ----------
    features : RigidBodyFeatures
        The robot, corrected by its effects.
    plan : Plan
        How the fit smoothed and filtered, with the values of the effects.
    theta : ndarray of shape (p,)
        Parameters.
    load : ndarray or None
        Parameters that the load of the effects is made with; see `make_motion`.
    ranges : tuple of EffectRange
        What each effect was fitted on: first friction by joint, then the effects, of
        which those that are not `bounded` are held within theirs. Empty, or for all.
    signal_ends : mapping of str to (float, float)
        Lowest and highest value of each recorded signal in the fit.
    spreads : tuple of Spread
        How well each effect is known.
    state_cutoff : "auto", float, array-like or None
        Cut-off [Hz] of a smoother for positions where the fit was given states.
    powers : ColumnPowers or None
        How large columns of friction and effects were in the fit.
    spread : TorqueSpread or None
        How far measured torques may be from predicted ones.
    """

    features: RigidBodyFeatures
    plan: Plan
    theta: np.ndarray
    load: np.ndarray | None = None
    ranges: tuple = ()
    signal_ends: Mapping = field(default_factory=dict)
    spreads: tuple = ()
    state_cutoff: object = "auto"
    powers: ColumnPowers | None = None
    spread: TorqueSpread | None = None

    @property
    def joint_names(self):
        """Names of the joints, tuple of str."""
        return joint_names(self.features.model_)

    @property
    def effects(self):
        """Effects in use, tuple of Effect."""
        return self.plan.effects

    @property
    def held(self):
        """Ranges that the effects in use are held within, None where they are not."""
        own = self.ranges[len(self.ranges) - len(self.effects) :]
        return tuple(
            None if effect.bounded else one for effect, one in zip(self.effects, own)
        )

    @property
    def held_plan(self):
        """The plan for predictions, with what effects are held within."""
        return replace(self.plan, ranges=self.held)

    # -- parameters by what they belong to ------------------------------------------

    def split(self, parameters):
        """Split parameters (p,) into those of each effect, a list.

        In the first of several passes effects of the load are missing.
        """
        return split_effects(self.effects, parameters[self.features.n_parameters_ :])

    def bodies(self, parameters):
        """Inertial and friction parameters of each joint, (nv, 10 + n_friction)."""
        rigid = parameters[: self.features.n_parameters_]
        return rigid.reshape(self.features.n_joints_, -1)

    def inertial(self):
        """Inertial parameters (nv, 10)."""
        return np.ascontiguousarray(self.bodies(self.theta)[:, :10])

    # -- queries --------------------------------------------------------------------

    def checked(self, X, signals):
        """Return positions or states, and the signals that effects vary with."""
        beside = columns_beside(X, self.joint_names)
        # Positions and states are both accepted, whichever were fitted.
        X = check_array(positions_in_order(X, self.joint_names), dtype=np.float64)
        check_widths(self.joint_names, X)
        return X, signals_for(self.effects, signals, beside, X.shape[0])

    def clock(self, t, n_samples):
        """Return the time of each row of a query [s], stamped if effects need it.

        Without stamps it begins as the fit did.
        """
        dt, time = self.plan.dt, self.plan.time
        if t is not None and self.plan.timed:
            return check_clock(t, n_samples, dt)
        clock = check_clock(None, n_samples, dt)
        return clock if time is None or clock is None else clock + time[0]

    def smoother(self, X, groups, *, in_band=False):
        """State estimator of a query; None if X holds states.

        With `in_band` it smooths to the identified band.
        """
        if X.shape[1] == 3 * self.features.n_joints_:
            return None
        estimator = self.plan.state_estimator
        if estimator is None:
            dt = check_dt(self.plan.dt)
            estimator = fit_states(dt, self.state_cutoff, X, groups)
        return smooth_to(estimator, self.plan.cutoff) if in_band else estimator

    def smoothed(self, X, groups, estimator):
        """States (n, 3 nv) by an estimator, and the `Rest` of their velocities."""
        if estimator is None:
            return X, self.plan.rest(np.zeros(self.features.n_joints_))
        states = estimator.transform(X, groups=groups)
        return states, self.plan.rest(estimator.velocity_noise())

    def query(self, X, groups):
        """States (n, 3 nv) of a query as the fit smooths, and the `Rest` of them."""
        return self.smoothed(X, groups, self.smoother(X, groups))

    def recording(self, X, y=None, groups=None, weight=None, t=None, signals=None):
        """Make a `Recording` of checked arrays; zero torques where none are given."""
        return recording_of(
            self.joint_names, self.plan.dt, X, y, groups, weight, t, signals
        )

    def ask(self, X, groups=None, t=None, weight=None, signals=None):
        """Make the `Query` of the rows of a recording."""
        smoother = self.smoother(X, groups, in_band=True)
        states, rest = self.smoothed(X, groups, smoother)
        clock = self.clock(t, X.shape[0])
        return Query(
            recording=self.recording(X, None, groups, weight, clock, signals),
            states=states,
            rest=rest,
            smoother=smoother,
        )

    # -- answers --------------------------------------------------------------------

    def predict(self, X, groups=None, t=None, signals=None, *, return_std=False):
        """Predict torques (n, nv); warn who called the caller of what is outside."""
        X, signals = self.checked(X, signals)
        if return_std and self.spread is None:
            raise ValueError(
                "return_std needs the covariance of the parameters, which this robot "
                "does not have: its regressor gives none (leave regressor=None, or use "
                "VBJFARegressor or JFARegressor), or it was saved by a version that "
                "did not keep it (fit and save again)."
            )
        asked = self.ask(X, groups, t, signals=signals)
        warn_outside(self.said_outside(asked), stacklevel=3)
        rows = self._rows(asked)
        torques = np.concatenate([one.predict(self.theta) for one in rows])
        if not return_std:
            return torques
        noiseless = asked.smoother is None
        spreads = [self.spread.std(one, noiseless=noiseless) for one in rows]
        return torques, np.concatenate(spreads)

    def torques(self, asked):
        """Torques (n, nv) that are predicted for a `Query`."""
        return np.concatenate([one.predict(self.theta) for one in self._rows(asked)])

    def _rows(self, asked):
        """Return the `RegressorRows` of each segment of a `Query`."""
        recording = asked.recording
        own = [asked.states[rows] for rows in recording.segments]
        return regressor_rows(
            recording,
            own,
            self.held_plan,
            self.features,
            theta=self.load,
            rest=asked.rest,
        )

    def outside(self, asked):
        """Find where a `Query` leaves what was fitted, tuple of `OutsideRange`."""
        inertial = None
        if any("load" in one.depends for one in self.ranges):
            inertial = self.inertial()
        signals = asked.signals(self.features, inertial)
        held = [one is not None for one in self.held]
        held = [False] * (len(self.ranges) - len(held)) + held
        return outside(self.ranges, held, signals, asked.counts(self.plan.standstill))

    def said_outside(self, asked):
        """Say where a `Query` leaves what was fitted, a list of str."""
        found = self.outside(asked)
        joints = self.joint_names, is_prismatic(self.features.model_)
        said = [outside_text(found, *joints)] if found else []
        said += signals_outside_text(self.signal_ends, asked.recording.signals)
        timed = self.of_time(asked)
        return said + (beyond_text(timed, self.plan.time, *joints) if timed else [])

    def of_time(self, asked):
        """Share of each effect of time in a `Query`, tuple of `EffectOfTime`."""
        if not any(effect.slow for effect in self.effects):
            return ()
        known = {"theta": self.load, "rest": asked.rest}
        motion = motion_of(
            asked.recording, asked.states, self.held_plan, self.features, **known
        )
        motions = own_motions(self.effects, self.held, motion)
        known = self.effects, self.split(self.theta), self.spreads, motions
        return tuple(
            effect_of_time(effect, coef, spread, own, self.plan.time)
            for effect, coef, spread, own in zip(*known)
            if effect.slow
        )

    # -- without data and estimator -------------------------------------------------

    def torque_model(self):
        """Return the `TorqueModel` of the robot, its states taken as noiseless."""
        bodies, nv = self.bodies(self.theta), self.features.n_joints_
        return TorqueModel(
            model=self.features.model_,
            bodies=np.ascontiguousarray(bodies[:, :10]),
            friction_names=self.features.friction_,
            friction=bodies[:, 10:].copy(),
            effects=self.effects,
            coefficients=tuple(own.copy() for own in self.split(self.theta)),
            ranges=self.held,
            gains=self.features.gains_.copy(),
            load=self._load(),
            rest=self.plan.rest(np.zeros(nv)),
            since=None if self.plan.time is None else self.plan.time[0],
            dt=self.plan.dt,
        )

    def _load(self):
        """Return the `Load` of the effects, or None."""
        if self.load is None:
            return None
        bodies = self.bodies(self.load)
        rest, coefficients = self.load[self.features.n_parameters_ :], []
        for effect in self.effects:
            width = len(effect.coefficients) if is_plain(effect) else 0
            own, rest = np.split(rest, [width])
            coefficients.append(own)
        return Load(
            bodies=np.ascontiguousarray(bodies[:, :10]),
            friction=bodies[:, 10:].copy(),
            coefficients=tuple(coefficients),
        )


def split_effects(effects, coefs):
    """Split coefficients of effects into those of each, a list."""
    widths = [len(effect.coefficients) for effect in effects]
    return np.split(coefs, np.cumsum(widths)[:-1]) if widths else []


def recording_of(names, dt, X, y, groups=None, weight=None, t=None, signals=None):
    """Make a `Recording` of checked arrays; zero torques where none are given."""
    nv = len(names)
    return take_arrays(
        X,
        np.zeros((X.shape[0], nv)) if y is None else y,
        groups,
        weight,
        t,
        dt=check_dt(dt) if X.shape[1] == nv or dt is not None else None,
        joint_names=names,
        signals=signals,
    )


class PredictsTorques:
    """A robot that has a `TorquePredictor`: one that was fitted, or read."""

    def _predictor(self):
        """Return the robot's `TorquePredictor`."""
        raise NotImplementedError(f"{type(self).__name__} must define _predictor().")

    def simulate(self, tau, q0, v0=None, t=None, *, signals=None):
        """Simulate the identified robot, driven by measured torques.

        Parameters
        ----------
        tau : array-like of shape (n_samples, nv)
            Torques that the channels measured [N m or N], one row per sample, or a data
            frame with the joints' names. Between rows they go straight.
        q0 : array-like of shape (nv,)
            Positions in the first row [rad or m].
        v0 : array-like of shape (nv,), default=None
            Velocities in the first row [rad/s or m/s]; None is at rest.
        t : array-like of shape (n_samples,), default=None
            Times of the rows [s], on the clock of the fit, at the sample period of the
            fit. None counts from the beginning of the fit.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Columns recorded beside the motion, for effects that vary with them.

        Returns
        -------
        ndarray of shape (n_samples, 3 * nv)
            States [q | v | a]; the first row is the start.

        Raises
        ------
        ValueError
            If torques, times or the start do not suit the robot (the message says what
            and where), the start lies outside the joint limits, or the robot has no
            positive inertia.
        SimulationError
            A ValueError; if the motion diverges, or its energy exceeds what was put in
            by more than 1 %, as with identified friction that drives a joint.

        Warns
        -----
        UserWarning
            If a joint leaves its limits, at which there are no stops; and of effects
            that have no forward dynamics (`effects.Elastic`, `effects.Jerk`).

        Notes
        -----
        Friction and all other effects are those of `predict`. Dry friction holds a
        joint at rest up to its size; the times at which joints stop, turn round and
        break loose are found, and steps of Runge's and Kutta's fourth order between
        them are as long as their error estimate allows. Where smooth friction or a
        stiffness is steep the steps are implicit (a Rosenbrock method). Delays and
        filters of a torque channel, and its gain, are taken back from `tau` first.

        Without feedback errors add up: two motions under the same torques part within
        seconds wherever gravity or a neighbour drives them apart. Compare with a
        recording over windows of about a second, each from a measured state.

        Examples
        --------
        >>> import numpy as np
        >>> from sklearn_vbjfa import RobotIdentifier
        >>> from sklearn_vbjfa.datasets import load_demo_recording
        >>> recording = load_demo_recording().select(0)
        >>> robot = RobotIdentifier(
        ...     recording.urdf, dt=recording.dt, friction=("viscous", "coulomb")
        ... )
        >>> robot = robot.fit(recording.q, recording.tau)
        >>> states = robot.state_estimator_.transform(recording.q)
        >>> rows = slice(1000, 1050)  # half a second
        >>> q0, v0 = states[1000, :6], states[1000, 6:12]
        >>> simulated = robot.simulate(recording.tau[rows], q0, v0)
        >>> simulated.shape
        (50, 18)
        """
        model = self._predictor().torque_model()
        tau = torques_in_order(tau, model.joint_names)
        return simulate(model, tau, q0, v0, t, signals=signals)


def predictor_of(robot):
    """Return the `TorquePredictor` of a fitted identifier or of a robot from a file."""
    return robot._predictor()
