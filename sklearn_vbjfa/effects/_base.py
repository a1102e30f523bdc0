"""Base classes of effects: columns of joint torques, computed from the motion."""

import functools
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_array

from sklearn_vbjfa._core._smoothing import contiguous_groups
from sklearn_vbjfa.effects._motion import Arrays, Motion, rows_of

# Units for a revolute and for a prismatic joint.
TORQUE, STIFFNESS = ("N m", "N"), ("N m/rad", "N/m")
POSITION, SPEED, TIME = ("rad", "m"), ("rad/s", "m/s"), ("s", "s")
VISCOSITY, INERTIA = ("N m s/rad", "N s/m"), ("kg m^2", "kg")
ANGLE, RATIO = ("rad", "rad"), ("", "")


# A subclass that defines one of these has another torque than its base class, so that
# the other descriptions of the torque are not inherited.
_DEFINITIONS = frozenset({"law", "columns"})
_DESCRIPTIONS = frozenset({"law", "terms", "simulated", "files", "alike"})
# Signals of a `Motion` that an effect may need, and their descriptions.
_BODIES = "the rigid-body dynamics"
_NEEDS = {
    "time": ("t", "time stamps"),
    "bodies": ("rigid", _BODIES),
    "end_bodies": ("end_bodies", _BODIES),
    "geometry": ("derivatives", _BODIES),
    "load": ("load", "the load, the torque of the rigid bodies"),
    "command": ("command", "the commands of a drive, or recorded torques"),
}
_NOT_IN_FORMAT = "the format has no such torque"


@dataclass(frozen=True, kw_only=True)
class InFiles:
    """Support of an effect in simulations, URDF and MJCF files."""

    simulation: str = ""  # reason why simulations omit it, if they do
    urdf: str = _NOT_IN_FORMAT  # what URDF cannot hold of it; empty if it holds all
    mjcf: str = _NOT_IN_FORMAT  # what MJCF cannot hold of it
    # MJCF elements, "constant", "spring" or "ref", and the coefficients in them
    places: tuple[tuple[str, str], ...] = ()
    # joint parameter of the files, and declared friction, to which it is added
    parameter: str = ""

    @classmethod
    def nowhere(cls, reason):
        """Return the support of an effect that neither format can hold, and why."""
        return cls(urdf=reason, mjcf=reason)


class Effect(TransformerMixin, BaseEstimator):
    """Base class of joint torques that are linear in their coefficients.

    A subclass needs `name`, `coefficients`, `units`, and its torque as `law` or
    `columns`; all other attributes have defaults. Its base classes state its
    kind: `Shaped` has shape parameters, `Converted` has other parameters than its
    coefficients, `Stateful` has memory, as a `Bank` of elements, `OfTime` changes with
    time, at an instant if it is `Sudden`, `OfSignals` with recorded signals, `InModel`
    corrects the rigid-body model, `OnAllJoints` acts on other joints, and `OfRobot`
    belongs to none. Instances are passed to
    ``EffectDiscovery(effects=[...])`` and ``RobotIdentifier(effects=[...])``.

    Parameters
    ----------
    joint : int, default=0
        Index of the joint, from zero; the first parameter of every effect.

    Attributes
    ----------
    name, label, formula : str
        Name, the same for all joints; name in reports; added torque in LaTeX.
    coefficients, units : tuple
        Symbols of the linear coefficients, one for each column, and their units, each
        for a revolute and for a prismatic joint.
    nonnegative : tuple of str
        Coefficients that physics requires to be nonnegative: a search rejects others.
    contains : tuple of str
        Simpler effects, which a search tries first.
    needs : tuple of {"time", "load", "bodies"}
        What it requires besides the states.
    depends : tuple of {"position", "speed", "load", "direction"}
        Quantities of its joint with which its columns grow: beyond a margin outside the
        range of the fit, predictions hold the torque constant.
    continuous : tuple of str
        Shape parameters that are searched between the values of `shapes` as well.
    bounded : bool
        Whether predictions do not hold it constant: the torque is bounded, or linear as
        viscous friction is.
    record : str
        What a recording must contain for the effect to be identifiable, and to be
        distinguished from its rivals.
    terms : tuple of (str, str, ...)
        Terms of the compiled forward dynamics, with coefficients and shape parameters.
    files : InFiles
        Its support in simulations, URDF and MJCF files.
    alike : bool
        Whether joints with equal drives have equal coefficients.

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

    name = ""
    label = ""
    formula = ""
    coefficients: tuple[str, ...] = ()
    units: tuple[tuple[str, str], ...] = ()
    record = "motion of the joint"
    contains: tuple[str, ...] = ()
    nonnegative: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    depends: tuple[str, ...] = ()
    continuous: tuple[str, ...] = ()
    bounded = False
    terms: tuple = ()
    files = InFiles()
    alike = False
    simple = False  # whether a search prefers this shape to others that do as well
    loads = False  # whether its torque is part of the load, as that of a body

    def __init_subclass__(cls, **kwargs):
        super().__init_subclass__(**kwargs)
        if not _DEFINITIONS.isdisjoint(vars(cls)):
            for name in _DESCRIPTIONS - vars(cls).keys():
                setattr(cls, name, vars(Effect)[name])

    def __init__(self, joint=0):
        self.joint = joint

    def law(self, maths):
        """Return the columns as a function of a state, or None if there is none.

        ``maths`` has ``exp``, ``cos``, ``sin``, ``sqrt``, and ``sign(joint)``, which
        returns a function of a joint's velocity and acceleration. Signals of a state
        are by joint, such as ``state.q[joint]``: floats, or arrays (n,) of a recording.
        The function returns a tuple with one value for each coefficient.
        """
        return None

    def columns(self, motion):
        """Return one column for each coefficient (n, k); by default those of the `law`.

        Those of an effect `OnAllJoints` are of shape (n, nv, k).
        """
        law = self.law(Arrays(motion.rest))
        if law is None:
            raise NotImplementedError(
                f"{type(self).__name__} must define columns(motion)."
            )
        terms = law(rows_of(motion))
        out = np.empty((len(terms), motion.q.shape[0]))
        for column, values in zip(out, terms):
            column[:] = values
        return out.T

    def simulated(self, table, *coef):
        """Add its terms to a `TermTable` of forward dynamics; False if not possible."""
        values = dict(zip(self.coefficients, coef))
        complete = bool(self.terms)
        for kind, *names in self.terms:
            arguments = [values[n] if n in values else getattr(self, n) for n in names]
            complete &= table.add(kind, self.joint, *arguments)
        return complete

    def shapes(self, motion):
        """Shape parameters to search, a list of dicts for `set_params`."""
        return [{}]

    def first_shapes(self, motion):
        """Return those of `shapes` that a search compares with other effects."""
        return self.shapes(motion)

    def forms(self):
        """Return the effect in other forms, over which intervals are averaged."""
        return []

    def applies(self, motion):
        """Return why the effect cannot be identified; empty if it can.

        A reason that begins with "needs" may not hold for another recording.
        """
        for need, (signal, description) in _NEEDS.items():
            if need in self.needs and getattr(motion, signal) is None:
                return f"needs {description}"
        return ""

    def plausible(self, coef):
        """Whether fitted coefficients have a sign and size that the effect can have."""
        return self.natural(coef)

    def natural(self, coef):
        """Whether the signs of coefficients are possible; see `nonnegative`."""
        fitted = dict(zip(self.coefficients, coef))
        return all(fitted[name] >= 0 for name in self.nonnegative)

    def opposite(self):
        """Return the effect with the opposite sign, as of a delay; None for others."""
        return None

    def excludes(self):
        """Return the keys of effects that a search does not combine with it, a set."""
        opposite = self.opposite()
        return {self.key()} | (set() if opposite is None else {opposite.key()})

    def parameters(self, coef):
        """Return the physical parameters, symbol -> value."""
        return dict(zip(self.coefficients, map(float, coef)))

    def in_file(self, coef):
        """Return the coefficients that a joint parameter of `files` holds, or zeros."""
        return np.asarray(coef, dtype=float)

    def completed(self):
        """Return the effect including the declared term that it replaces."""
        return self

    def linearised_at(self, coef):
        """Return the effect linearised at its coefficients, if it is linearised."""
        return self

    def parameter_units(self, prismatic=False):
        """Units of `parameters` and of the shape parameters, symbol -> unit."""
        return _select_units(zip(self.coefficients, self.units), prismatic)

    def prefix(self, joint_name):
        """Return the beginning of the names of its parameters."""
        return f"{joint_name}:{self.name}"

    @property
    def constant(self):
        """Coefficient of a constant torque, as in `Offset`; empty for none."""
        constants = (names[0] for kind, *names in self.terms if kind == "constant")
        return next(constants, "")

    @classmethod
    def describe(cls, shape, joint_label):
        """Return a label for sentences, with the choices in a shape (a mapping).

        ``joint_label`` turns a joint, counted from zero, into its label.
        """
        chosen = [value for value in shape.values() if isinstance(value, str) and value]
        label = cls.label or cls.name.replace("_", " ")
        return f"{label} ({', '.join(chosen)})" if chosen else label

    @classmethod
    @functools.cache
    def _get_param_names(cls):
        # Cached, because a search calls it some 100,000 times.
        return super()._get_param_names()

    def shape(self):
        """Shape parameters in use."""
        shape = self.get_params(deep=False)
        del shape["joint"]
        return shape

    def check(self):
        """Raise ValueError for a joint that is not an integer."""
        if isinstance(self.joint, bool) or not isinstance(self.joint, Integral):
            raise ValueError(
                f"joint must be an integer, counted from zero; got {self.joint!r}."
            )

    @property
    def joints(self):
        """Joints among its parameters, a tuple."""
        return (self.joint,)

    def acts_on(self, nv):
        """Return the joints whose torque it changes, a list."""
        return [self.joint]

    def in_all(self, columns, nv):
        """Return its columns in the torques of all joints, (n, nv, k)."""
        out = np.zeros((len(columns), nv, columns.shape[-1]))
        out[:, self.joint] = columns
        return out

    def check_joints(self, nv):
        """Raise ValueError for joints that a robot with `nv` joints does not have."""
        for joint in self.joints:
            if not 0 <= joint < nv:
                raise ValueError(
                    f"effects names joint {joint} for {self.name}; expected 0 to "
                    f"{nv - 1}, for {nv} joint(s)."
                )

    @property
    def tuned(self):
        """Parameters that are not part of its `key`, a tuple."""
        return self.continuous

    @property
    def slow(self):
        """Whether it could imitate any slow change of the torque."""
        return isinstance(self, OfTime)

    def key(self):
        """Return what distinguishes it in a model: all that is not `tuned`."""
        fixed = {k: v for k, v in self.shape().items() if k not in self.tuned}
        return (self.name, self.joint, tuple(sorted(fixed.items())))

    def fit(self, X, y=None):
        """Check states [q | v | a], array-like of shape (n_samples, 3 * nv)."""
        self.n_features_in_ = 3 * self._motion(X).n_joints
        return self

    def transform(self, X, *, t=None, load=None, groups=None, signals=None):
        """Compute the columns in some states.

        Parameters
        ----------
        X : array-like of shape (n_samples, 3 * nv)
            States [q | v | a].
        t, load, groups, signals : default=None
            Time (n_samples,) [s], torques of the rigid bodies (n_samples, nv) [N m or
            N], labels of separate recordings (n_samples,), and recorded signals
            (n_samples,) by name; each is required by the effects that need it.

        Returns
        -------
        ndarray of shape (n_samples, k)
            One column for each coefficient.

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
        n, nv = X.shape[0], X.shape[1] // 3
        if X.shape[1] % 3:
            raise ValueError(
                f"X must hold states [q | v | a], three columns a joint; got "
                f"{X.shape[1]} columns."
            )
        self.check_joints(nv)
        q, v, a = np.split(X, 3, axis=1)
        return Motion(
            q=q,
            v=v,
            a=a,
            t=_check_signal("t", t, (n,)),
            load=_check_signal("load", load, (n, nv)),
            parts=tuple(contiguous_groups(groups, n)),
            signals={
                name: _check_signal(f"signals[{name!r}]", values, (n,))
                for name, values in ({} if signals is None else signals).items()
            },
        )

    def get_feature_names_out(self, input_features=None):
        """Names of the columns, ndarray of str, such as "joint 2:coulomb:Fc"."""
        prefix = f"joint {self.joint + 1}:{self.name}"
        return np.array([f"{prefix}:{c}" for c in self.coefficients], dtype=object)


class Shaped(Effect):
    """An effect with shape parameters: values to search that are not coefficients.

    They are parameters of ``__init__``; `Effect.shapes` lists values to try.

    Attributes
    ----------
    shape_units : tuple of (str, (str, str))
        Shape parameters and their units.
    positive : tuple of str
        Those that must be greater than zero, or tuples of such.
    coarse : tuple of str
        Continuous ones, changes of which move the torque of single samples by steps.
    cyclic : tuple of str
        Angles [rad], with a period of one turn.
    choices : tuple of (str, tuple)
        Those with few values, and these values.
    split_by : tuple of str
        Those whose values mean different causes (which signal): a search reports values
        that explain as much as the best one as its rivals.
    """

    shape_units: tuple = ()
    positive: tuple[str, ...] = ()
    coarse: tuple[str, ...] = ()
    cyclic: tuple[str, ...] = ()
    choices: tuple = ()
    split_by: tuple[str, ...] = ()

    def check(self):
        """Raise ValueError for bad choices and shape parameters out of range, too."""
        super().check()
        for name, allowed in self.choices:
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"{name} of {self.name} must be one of {list(allowed)}; got "
                    f"{getattr(self, name)!r}."
                )
        for name in self.positive:
            setting = getattr(self, name)
            for value in setting if isinstance(setting, (tuple, list)) else [setting]:
                if not (isinstance(value, Real) and 0 < value < np.inf):
                    raise ValueError(
                        f"{name} of {self.name} must be positive and finite; got "
                        f"{value!r}."
                    )

    def parameter_units(self, prismatic=False):
        units = _select_units(self.shape_units, prismatic)
        return super().parameter_units(prismatic) | units


class Converted(Effect):
    """An effect whose `parameters` differ from its coefficients.

    Attributes
    ----------
    named_units : tuple of (str, (str, str))
        Symbols and units of the parameters.
    """

    named_units: tuple = ()

    def parameter_units(self, prismatic=False):
        return _select_units(self.named_units, prismatic)


class Stateful(Effect):
    """An effect whose columns depend on earlier or later samples.

    Torques of single states include it if it has a `law`, which may store earlier
    states; each call of `law` returns a function without them.
    """


class Bank(Stateful):
    """Elements of positive size in place of Coulomb friction, one for each column.

    A search drops elements whose size is not positive.
    """

    at_rest = True  # whether a fit uses samples of its joint at rest


class OfTime(Effect):
    """An effect that changes with time: a search judges it by slow changes alone."""

    needs: tuple[str, ...] = ("time",)


class Sudden(Shaped, OfTime):
    """An effect from `instant` to `until` (None: permanent), without intervals."""

    shape_units = (("instant", TIME), ("until", TIME))
    tuned = ("instant", "until")

    @property
    def changes(self):
        """Times [s] at which it begins and ends, with the signs of the change."""
        changes = (self.instant, 1.0), (self.until, -1.0)
        return [(t, sign) for t, sign in changes if t is not None]


class OfSignals(Effect):
    """An effect of recorded signals; `recorded` holds their names."""

    needs = ("signals",)
    recorded: tuple[str, ...] = ()


class OnAllJoints(Effect):
    """An effect that acts on all joints, with columns of shape (n, nv, k)."""

    def acts_on(self, nv):
        return list(range(nv))

    def in_all(self, columns, nv):
        return columns


class OfRobot(OnAllJoints):
    """An effect that belongs to no joint."""

    def prefix(self, joint_name):
        return self.name


def _select_units(units, prismatic):
    return {name: pair[int(bool(prismatic))] for name, pair in units}


def _check_signal(name, values, shape):
    """Return an argument as an array of floats of a shape, or None."""
    if values is None:
        return None
    values = check_array(values, ensure_2d=False, dtype=np.float64)
    if values.shape != shape:
        raise ValueError(f"{name} must have shape {shape}; got {values.shape}.")
    return values
