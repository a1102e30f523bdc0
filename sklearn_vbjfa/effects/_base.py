"""What an effect is: columns of a joint's torque, computed from the motion."""

import functools
import itertools
from numbers import Integral, Real

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_array

from sklearn_vbjfa.effects._motion import (
    AllJoints,
    Arrays,
    Motion,
    every_joint,
    rows_of,
)

# Units for a revolute and for a prismatic joint.
TORQUE, STIFFNESS = ("N m", "N"), ("N m/rad", "N/m")
POSITION, SPEED, TIME = ("rad", "m"), ("rad/s", "m/s"), ("s", "s")
VISCOSITY, INERTIA = ("N m s/rad", "N s/m"), ("kg m^2", "kg")


# What an effect's torque is said by, and what is said of it elsewhere.
_TORQUE = frozenset({"law", "column", "columns"})
_OF_TORQUE = frozenset({"law", "terms", "simulated", "not_simulated", "reads_torque"})
_OF_TORQUE |= {"alike"}
_OF_TORQUE |= {"joint_parameter", "mjcf", "in_files", "no_place", "no_urdf", "no_mjcf"}


class Effect(TransformerMixin, BaseEstimator):
    """Something that adds torque to a joint, linear in its coefficients.

    A class of its own is all that a new effect needs: `name`, the coefficients'
    `coefficients` and `units`, its torque as `law` or as `columns`, and `shapes` if
    there is anything to search. Whatever else is said about an effect elsewhere (its
    label in a report, what to record next, what it is in a simulation or in a file of
    another program) is read off its class, and has a default that works.
    Instances go into ``EffectDiscovery(effects=[...])`` and
    ``RobotIdentifier(effects=[...])`` like those of the library.

    Parameters
    ----------
    joint : int, default=0
        Joint that the effect acts on, from zero.

    Attributes
    ----------
    name : str
        Name, the same for all joints.
    label : str
        What an engineer calls it, in a sentence; by default the name.
    formula : str
        What it adds to the torque, in LaTeX: guide and reports typeset it.
    coefficients : tuple of str
        Symbols of the linear coefficients, one for each column.
    units : tuple of (str, str)
        Their units, for a revolute and for a prismatic joint.
    named_units : tuple of (str, (str, str))
        Symbols and units of what `parameters` returns, where that is not the
        coefficients.
    shape_units : tuple of (str, (str, str))
        Shape parameters and their units.
    contains : tuple of str
        Plainer effects that this one must beat: a search takes those first that are
        probable by themselves.
    holds : tuple of (str, str)
        Plain terms that are a column of its own as well, with that coefficient. Where
        several have it, the first effect of the joint has the sum, the others and the
        plain term have zero.
    needs : tuple of {"time", "load", "signals"}
        Signals besides the states.
    continuous : tuple of str
        Shape parameters that take any value between those of `shapes`.
    neutral : tuple of (str, float)
        Those of them that do nothing at a value: a search leaves them there unless the
        data say otherwise.
    cyclic : tuple of str
        Those of them that are angles [rad], the same again after a turn.
    jumping : tuple of str
        Those of them in which the torque jumps (an instant): they get no interval.
    partners : tuple of str
        Shape parameters that are the number of another joint.
    apart : tuple of str
        Shape parameters that make it another effect to an engineer (which signal):
        where several do as well as the best, a search reports them as its rivals.
    tangent : tuple of str
        Parameters around which columns are linearised; `at` sets them.
    positive : tuple of str
        Shape parameters that must be greater than zero.
    nonnegative : tuple of str
        Coefficients that are not negative in nature: what a search finds with another
        sign is something else.
    negative : tuple of (str, str)
        Coefficients whose sign is not plain, and what a negative one means.
    depends : tuple of {"position", "speed", "load", "direction"}
        Quantities of its joint that its columns go on changing with however large they
        become: predictions follow them up to the margin of the range of the fit, beyond
        which its torque stays as it is there, unless it is `bounded`; see
        `EffectRange`. What saturates or fades with them (a sign, a Stribeck curve) has
        its value outside the range as well and is left out; a sign depends on the
        direction, for a joint that never reversed.
    bounded : bool
        Whether the law has a largest torque, however far out what it `depends` on, so
        that predictions follow it outside the range of the fit as well.
    curved : bool
        Whether the columns do so in another way than along a straight line, so that
        less lies between what is known and what is not.
    seen_over : {"", "position", "speed", "acceleration", "load", "time", "signal"}
        What a picture of it has on its horizontal axis: a signal of its joint, the
        time, or the recorded signal that it uses (the first of `recorded`). Empty for
        its own torque, where no single signal shows it.
    with_motion : bool
        Whether that picture counts torques in the direction of the motion, as of a
        friction that has the same size both ways.
    memory : {"none", "past", "future"}
        What else than its own row a row of the columns depends on: nothing, rows
        before it (a hysteresis, a lag), or rows after it too (a derivative by central
        differences). Torques state by state, as in a control loop, take the columns of
        "none" from motions of one row, those of "past" from `one_by_one`, and leave
        out "future".
    visible : str
        What a recording must hold for the effect to show.
    record : str
        What to record next to tell it from its rivals.
    slow : bool
        Whether it is a function of time, which could imitate whatever changes slowly:
        a search counts its evidence by slow changes alone.
    afterwards : str
        What a `slow` effect is taken to do after the last time of the fit.
    terms : tuple of (str, str, ...)
        What it is in a simulation: kinds of terms that the simulation knows, each with
        the coefficients and shape parameters that it is made of. Empty, it is simulated
        by its own columns, which is slower and leaves out what depends on other rows.
    not_simulated : str
        Why a simulation goes without it; empty for all that can be simulated.
    mjcf : tuple of (str, str, ...)
        What of it an MJCF file has: "constant", "spring", "ref" or "tendons", each with
        the coefficients that go there.
    in_files : tuple of {"urdf", "mjcf"}
        Files that have all of it in another way.
    no_place, no_urdf, no_mjcf : str
        Why files have no place for the rest of it, either of them, URDF or MJCF;
        empty says that it is an effect of the user's own.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa.effects import Effect
    >>> class Cubic(Effect):
    ...     '''Cubic spring, tau = k3 q^3.'''
    ...     name = "cubic"
    ...     coefficients = ("k3",)
    ...     units = (("N m/rad^3", "N/m^3"),)
    ...     def columns(self, motion):
    ...         return motion.q[:, [self.joint]] ** 3
    >>> Cubic(joint=1).fit_transform(np.array([[0.0, 2.0, 0, 0, 0, 0]]))
    array([[8.]])
    """

    # What every effect says.
    name = ""
    coefficients: tuple[str, ...] = ()
    units: tuple[tuple[str, str], ...] = ()
    # In words: reports, guide and pictures.
    label = ""
    formula = ""
    named_units: tuple = ()
    visible = "the joint moves"
    record = ""
    negative: tuple = ()
    seen_over = ""
    with_motion = False
    # What its columns are made from, and where predictions follow them.
    needs: tuple[str, ...] = ()
    memory = "none"
    depends: tuple[str, ...] = ()
    bounded = False
    curved = False
    # What a search knows of it, beside others.
    contains: tuple = ()
    holds: tuple[tuple[str, str], ...] = ()
    nonnegative: tuple = ()
    apart: tuple[str, ...] = ()
    # Of effects with equal columns the one with the lowest gives its name to all.
    precedence = 0
    # Shape parameters: what is not linear.
    shape_units: tuple = ()
    continuous: tuple[str, ...] = ()
    neutral: tuple = ()
    cyclic: tuple[str, ...] = ()
    jumping: tuple[str, ...] = ()
    partners: tuple[str, ...] = ()
    tangent: tuple[str, ...] = ()
    positive: tuple[str, ...] = ()
    # Change with time.
    slow = False
    afterwards = ""
    # In simulations and in files of other programs.
    terms: tuple = ()
    not_simulated = ""
    mjcf: tuple = ()
    in_files: tuple = ()
    no_place = ""
    no_urdf = ""
    no_mjcf = ""
    # Kinds. True for an effect that acts on all joints: columns of shape (n, nv, k).
    whole_robot = False
    # "robot" for an effect that belongs to no joint; its joint is the first.
    scope = "joint"
    # True for an effect whose value is part of the robot model; see `ModelEffect`.
    in_model = False
    # True for one of what is read of a torque; see `_channels`.
    in_channel = False
    # True for one that changes the last body's `inertial` parameters at an `instant`.
    in_last_body = False
    # True for one whose coefficients a mirrored joint has as well, see `_alike`.
    alike = False
    # False for one that needs the load, and not the torque of the whole model.
    reads_torque = True
    # Name of the joint parameter of files, and declared friction, that it adds to.
    joint_parameter = ""

    def __init_subclass__(cls, **kwargs):
        super().__init_subclass__(**kwargs)
        # With a torque of its own nothing holds that a base says of another torque.
        if not _TORQUE.isdisjoint(vars(cls)):
            for said in _OF_TORQUE - vars(cls).keys():
                setattr(cls, said, vars(Effect)[said])

    def __init__(self, joint=0):
        self.joint = joint

    @property
    def trend(self):
        """Whether it adds a torque of its own that need not change with the motion.

        Such a torque could imitate whatever changes slowly: its evidence counts like
        that of a `slow` effect.
        """
        return False

    @property
    def corner(self):
        """Frequency above which it filters a channel [Hz]; None if it is not a filter.

        A filter within the frequencies of the motion stands for something else.
        """
        return None

    @property
    def owner(self):
        """Name of the body or joint that its coefficients bear; empty for its own."""
        return ""

    # -- what a new effect says ---------------------------------------------------

    def law(self, maths):
        """Return its torques as a function of a state, once for floats and arrays.

        Where `columns` say more than this, such as a memory, both are defined, and
        agree.

        Parameters
        ----------
        maths : Arrays or Floats
            Has ``exp``, ``cos``, ``sin``, ``sqrt``, and ``sign(joint, smoothing=0.0)``,
            which returns a function of a joint's velocity and acceleration.

        Returns
        -------
        callable or None
            `State` -> tuple with one value for each coefficient. The signals of a
            state are by joint, such as ``state.q[joint]``: arrays (n,) in a recording,
            floats where torques are asked for state by state. None, the default, for
            an effect that defines `columns` alone.
        """
        return None

    def columns(self, motion):
        """Compute the columns; by default those of the `law`.

        Parameters
        ----------
        motion : Motion
            Signals.

        Returns
        -------
        ndarray of shape (n, k)
            One column for each coefficient; (n, nv, k) for a `whole_robot` effect.
        """
        law = self.law(Arrays(motion.rest))
        if law is None:
            raise NotImplementedError(
                f"{type(self).__name__} must define columns(motion)."
            )
        found = law(rows_of(motion))
        out = np.empty((motion.q.shape[0], len(found)))
        for column, values in zip(out.T, found):
            column[:] = values
        return out

    def simulated(self, table, *coef):
        """Enter it into the forward dynamics of a robot; by default its `terms`.

        Parameters
        ----------
        table : TermTable
            Takes what a simulation knows; see `sklearn_vbjfa.simulation`.
        *coef : float
            Coefficients.

        Returns
        -------
        bool
            Whether it is entered; False if it is to be simulated by its own columns.
        """
        known = dict(zip(self.coefficients, coef))
        done = bool(self.terms)
        for kind, *names in self.terms:
            numbers = [known[n] if n in known else getattr(self, n) for n in names]
            done &= table.add(kind, self.joint, *numbers)
        return done

    def one_by_one(self):
        """Return a function that computes the columns row by row.

        Returns
        -------
        callable or None
            `Motion` of one row -> columns of that row, (1, k) or (1, nv, k); called
            with the rows of a recording in the order of time. By default `columns`
            itself for an effect without `memory`, and None for others: an effect with
            memory returns a new function that remembers what it needs, and is left out
            of torques state by state otherwise.
        """
        return self.columns if self.memory == "none" else None

    def shapes(self, motion):
        """Shape parameters to search, a list of dicts for `set_params`."""
        return [{}]

    def applies(self, motion):
        """Say why the effect cannot be looked for, or return an empty string.

        A reason that begins with "needs" names a signal that another recording may
        have: a report lists the effect as hidden.
        """
        for need in self.needs:
            if need == "time" and motion.t is None:
                return "needs time stamps"
            if need == "load" and motion.load is None:
                return "needs the load, the torque of the rigid bodies"
        return ""

    def plausible(self, coef):
        """Whether fitted coefficients are of the sign and size the effect has."""
        return self.natural(coef)

    def natural(self, coef):
        """Whether no coefficient is negative that cannot be; see `nonnegative`."""
        fitted = dict(zip(self.coefficients, coef))
        return all(fitted[name] >= 0 for name in self.nonnegative)

    @property
    def recorded(self):
        """Names of the recorded signals that it uses, tuple of str; `needs` "signals".

        Empty for one that is not set to any yet.
        """
        return ()

    def opposite(self):
        """Return the effect mirrored in what must have a sign, such as a delay in time.

        Where the mirror image explains nearly as much, the data show something
        symmetric, and a search finds neither. None where there is no such image.
        """
        return None

    def excludes(self):
        """Return the keys of effects that a search puts not beside this one, a set."""
        opposite = self.opposite()
        return {self.key()} | (set() if opposite is None else {opposite.key()})

    def parameters(self, coef):
        """Return what an engineer calls the coefficients, symbol -> value."""
        return dict(zip(self.coefficients, map(float, coef)))

    def later(self, coef, t):
        """Return what is left of the coefficients at a time [s], symbol -> value.

        Empty for what does not change with time, and for what stays as it is.
        """
        return {}

    def at(self, coef):
        """Return the effect linearised at its coefficients; see `tangent`."""
        return self

    def parameter_units(self, prismatic=False):
        """Units of `parameters` and of the shape parameters, symbol -> unit."""
        named = self.named_units or zip(self.coefficients, self.units)
        kind = int(bool(prismatic))
        return {name: units[kind] for name, units in (*named, *self.shape_units)}

    @classmethod
    def describe(cls, shape, joint_label):
        """Say what to call the effect in a sentence, with what matters of its shape.

        Parameters
        ----------
        shape : mapping of str to object
            Shape parameters; those that are missing are not spoken of.
        joint_label : callable
            Joint, from zero -> what to call it.

        Returns
        -------
        str
            Label.
        """
        return cls.label or cls.name.replace("_", " ")

    def told_beside(self, other):
        """Return what to call the effect among the rivals of another one.

        Its name; one of several uses on a joint says what sets it apart.

        Parameters
        ----------
        other : Effect
            What it cannot be told from.

        Returns
        -------
        str
            Name.
        """
        return self.name

    # -- derived ------------------------------------------------------------------

    @classmethod
    @functools.cache
    def _get_param_names(cls):
        # The search asks a hundred thousand times what never changes.
        return super()._get_param_names()

    @property
    def complexity(self):
        """Number of coefficients and searched shape parameters."""
        return len(self.coefficients) + len(self.continuous)

    @property
    def everywhere(self):
        """Whether all joints tell of the effect, not its own alone."""
        return self.whole_robot or self.in_model

    def shape(self):
        """Shape parameters in use."""
        parameters = self.get_params(deep=False)
        parameters.pop("joint")
        return parameters

    def check(self):
        """Refuse a joint that is not a number, and shape parameters out of range."""
        if isinstance(self.joint, bool) or not isinstance(self.joint, Integral):
            raise ValueError(
                f"joint must be an integer, counted from zero; got {self.joint!r}."
            )
        for name in self.positive:
            value = getattr(self, name)
            if not (isinstance(value, Real) and 0 < value < np.inf):
                raise ValueError(
                    f"{name} of {self.name} must be positive and finite; got {value!r}."
                )

    def key(self):
        """Tell two uses of the effect apart: all but what is tuned."""
        tuned = {*self.continuous, *self.tangent}
        fixed = {k: v for k, v in self.shape().items() if k not in tuned}
        return (self.name, self.joint, tuple(sorted(fixed.items())))

    def fit(self, X, y=None):
        """Check the states.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 * nv)
            States [q | v | a].
        y : None
            Ignored.

        Returns
        -------
        self : object
            Fitted transformer.
        """
        self._motion(X)
        self.n_features_in_ = np.shape(X)[1]
        return self

    def transform(self, X, *, t=None, load=None, groups=None, signals=None):
        """Compute the effect's columns.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 * nv)
            States [q | v | a].
        t : array-like of shape (n_samples,), default=None
            Time [s]; needed by effects that change with time.
        load : array-like of shape (n_samples, nv), default=None
            Torques of the rigid bodies [N m or N]; needed by effects of the load.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        signals : mapping of str to array-like of shape (n_samples,), default=None
            What was recorded beside the motion; needed by effects that vary with it.

        Returns
        -------
        ndarray of shape (n_samples, k)
            Columns, one for each coefficient.

        Raises
        ------
        ValueError
            If a signal that the effect needs is missing.
        """
        motion = self._motion(X, t, load, groups, signals)
        reason = self.applies(motion)
        if reason:
            raise ValueError(f"{self.name} on joint {self.joint + 1}: {reason}.")
        return self.columns(motion)

    def _motion(self, X, t=None, load=None, groups=None, signals=None):
        self.check()
        X = check_array(X, dtype=np.float64)
        nv = X.shape[1] // 3
        if X.shape[1] % 3:
            raise ValueError(
                f"X must hold states [q | v | a], three columns a joint; got "
                f"{X.shape[1]} columns."
            )
        if not 0 <= self.joint < nv:
            raise ValueError(
                f"joint must be one of 0 to {nv - 1}, for {nv} joints; got "
                f"{self.joint!r}."
            )
        if t is not None:
            t = check_array(t, ensure_2d=False, dtype=np.float64)
            if t.shape != X.shape[:1]:
                raise ValueError(
                    f"t must hold one time per row, shape {X.shape[:1]}; got {t.shape}."
                )
        if load is not None:
            load = check_array(load, dtype=np.float64)
            if load.shape != (X.shape[0], nv):
                raise ValueError(
                    f"load must have shape {(X.shape[0], nv)}; got {load.shape}."
                )
        return Motion(
            q=X[:, :nv],
            v=X[:, nv : 2 * nv],
            a=X[:, 2 * nv :],
            t=t,
            load=load,
            parts=_parts(groups, X.shape[0]),
            signals=_checked(signals, X.shape[0]),
        )

    def get_feature_names_out(self, input_features=None):
        """Names of the columns, such as "joint 2:coulomb:Fc".

        Parameters
        ----------
        input_features : None
            Ignored.

        Returns
        -------
        ndarray of str
            Names.
        """
        return np.array(
            [f"joint {self.joint + 1}:{self.name}:{c}" for c in self.coefficients],
            dtype=object,
        )


class JointEffect(Effect):
    """An effect of one column, made from its joint's velocity and acceleration alone.

    Such a column is cheap to make for all joints at once, so that a robot may declare
    it by name: ``RobotIdentifier(friction=["coulomb"])``.

    Parameters
    ----------
    joint : int, default=0
        Joint that the effect acts on, from zero.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa.effects import JointEffect
    >>> class Cubic(JointEffect):
    ...     '''Drag of the third degree, tau = F3 v^3.'''
    ...     name = "cubic"
    ...     coefficients = ("F3",)
    ...     units = (("N m s^3/rad^3", "N s^3/m^3"),)
    ...     def column(self, v, a, rest=None):
    ...         return v**3
    >>> Cubic(joint=1).fit_transform(np.array([[0, 0, 0, 2.0, 0, 0]]))
    array([[8.]])
    """

    def column(self, v, a, rest=None):
        """Compute the column of each joint; by default that of the `law`.

        Parameters
        ----------
        v, a : ndarray of shape (n, nv)
            Velocities and accelerations.
        rest : Rest or None
            What to take for the sign of the velocity of a joint that may be standing.

        Returns
        -------
        ndarray of shape (n, nv)
            One column for each joint.
        """
        law = self.law(AllJoints(rest))
        if law is None:
            raise NotImplementedError(
                f"{type(self).__name__} must define column(v, a)."
            )
        (found,) = law(every_joint(v, a))
        return np.array(np.broadcast_to(found, np.shape(v)))

    def columns(self, motion):
        """Compute the column of the effect's own joint; see `Effect.columns`."""
        own = [self.joint]
        rest = None if motion.rest is None else motion.rest.pick(*own)
        return self.column(motion.v[:, own], motion.a[:, own], rest)


def _parts(groups, n):
    if groups is None:
        return (slice(0, n),)
    labels = np.asarray(groups)
    if labels.shape != (n,):
        raise ValueError(
            f"groups must hold one label per row, shape ({n},); got {labels.shape}."
        )
    edges = np.r_[0, np.flatnonzero(labels[1:] != labels[:-1]) + 1, n]
    return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges))


def _checked(signals, n):
    """Return signals as arrays (n,) of floats, by name."""
    found = {}
    for name, values in ({} if signals is None else signals).items():
        found[name] = check_array(values, ensure_2d=False, dtype=np.float64)
        if found[name].shape != (n,):
            raise ValueError(
                f"signals[{name!r}] must hold one value per row, shape ({n},); got "
                f"{found[name].shape}."
            )
    return found
