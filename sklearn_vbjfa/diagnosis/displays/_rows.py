"""What a fit found, one row a number: parameters with intervals, and noise."""

from itertools import zip_longest

import numpy as np
from scipy import stats

from sklearn_vbjfa.diagnosis.displays._base import Display, fitted_robot
from sklearn_vbjfa.model._trees import is_prismatic

# Most rows of one panel; a longer one continues in further axes.
_MOST_ROWS = 36
# Height of a row, and of what is around a panel [inch].
_ROW, _AROUND = 0.17, 0.62
_COLOUR, _SECOND = "tab:blue", "tab:orange"
_SHARE = "share of the variance"
# From this ratio of the largest to the smallest value on, a linear axis would hide
# the small ones.
_LOG_RATIO = 20.0
_MARKERS = ("o", "D", "s", "^", "v", "P")
_NOISE_COLOURS = (
    "tab:blue",
    "tab:orange",
    "tab:green",
    "0.35",
    "tab:purple",
    "tab:brown",
)


class ParameterDisplay(Display):
    """Estimated parameters with intervals, projected and not, beside nominal values.

    One panel for each unit and joint (the part of a name before the colon), since
    parameters of different units cannot share an axis, and those of the shoulder
    would hide those of the wrist. Parameters that the data do not determine on their
    own have hollow marks and grey names.

    Parameters
    ----------
    estimate : array-like of shape (p,)
        Parameters.
    names : sequence of p str
        Their names, such as "joint_1:m" or "x0".
    units : sequence of p str
        Their units; empty for none that is known.
    second : array-like of shape (p,), default=None
        Another estimate of them, such as that before a projection.
    std : array-like of shape (p,), default=None
        Standard deviations; nan or infinity where unknown.
    identifiable : array-like of shape (p,), bool, default=None
        Parameters that the data determine; None for all.
    nominal : array-like of shape (p,), default=None
        Values to compare with; nan where there is none.
    labels : dict of str to str, default=None
        Legend entries other than the usual ones for "estimate", "second",
        "nominal", "open" (not identifiable).
    interval_of : {"estimate", "second"}, default="estimate"
        Which of the two `std` belongs to.

    Attributes
    ----------
    figure_ : matplotlib Figure
        Figure, after `plot`.
    axes_ : ndarray of Axes, shape (n_panels,)
        Axes, after `plot`, in the order of `panels`.
    lines_ : list of matplotlib Line2D
        Marks of each panel, after `plot`: nominal values, estimates, hollow ones.
    intervals_ : list of matplotlib LineCollection
        Intervals of each panel that has some, after `plot`.

    See Also
    --------
    ParameterDisplay.from_estimator : Make one from a fitted model.

    Examples
    --------
    >>> from sklearn_vbjfa.diagnosis import ParameterDisplay
    >>> display = ParameterDisplay(
    ...     estimate=[2.1, 0.4, 0.7], std=[0.1, 0.1, 0.2], nominal=[2.0, 0.5, 0.5],
    ...     names=["arm:m", "arm:viscous", "arm:offset"],
    ...     units=["kg", "N m s/rad", "N m"])
    >>> display.panels
    [('arm', 'kg', [0]), ('arm', 'N m s/rad', [1]), ('arm', 'N m', [2])]
    """

    _accepts = "a RobotIdentifier, an EffectDiscovery or a linear regressor"

    def __init__(
        self,
        *,
        estimate,
        names,
        units,
        second=None,
        std=None,
        identifiable=None,
        nominal=None,
        labels=None,
        interval_of="estimate",
    ):
        self.estimate = estimate
        self.names = names
        self.units = units
        self.second = second
        self.std = std
        self.identifiable = identifiable
        self.nominal = nominal
        self.labels = labels
        self.interval_of = interval_of

    @classmethod
    def from_estimator(cls, estimator, *, nominal=None, parameters=None, units=None):
        """Show the parameters of a fitted model.

        Of a robot: `theta_` and, where it was projected, `theta_unconstrained_`, to
        which the intervals belong (`theta_std_`); hollow what is not `identifiable_`.
        They are for independent residuals and no model error, hence lower limits.
        Of a regressor: `coef_` with `coef_std_`, and `coef_noisy_`; hollow what is not
        `relevant_`.

        Parameters
        ----------
        estimator : RobotIdentifier, EffectDiscovery, VBJFARegressor or JFARegressor
            Fitted; of a discovery the completed model is shown. Any regressor with
            one output and `coef_` will do.
        nominal : array-like of shape (p,), default=None
            True values, or those of a data sheet, of all parameters in their order;
            nan where there is none.
        parameters : sequence of str or int, or array-like of bool, default=None
            Which to show: names, joints (all of that joint), numbers, or a mask such
            as `identifiable_`. None shows all.
        units : sequence of str, default=None
            Units of a regressor's coefficients; None shows them in one panel, as if
            they had one unit.

        Returns
        -------
        ParameterDisplay
            Display; call `plot`.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the estimator is not fitted.
        ValueError
            If it has no parameters to show, or an argument does not match them.
        """
        robot = fitted_robot(estimator)
        if robot is None:
            values = cls._of_regressor(estimator, units)
        else:
            _refuse_units(units, estimator, "parameters have units of their own")
            values = cls._of_robot(robot)
        names = values["names"]
        if nominal is not None:
            values["nominal"] = _check_nominal(nominal, len(names))
        chosen = _select(parameters, names)
        for key, value in values.items():
            if key in ("names", "units"):
                values[key] = tuple(value[i] for i in chosen)
            elif isinstance(value, np.ndarray):
                values[key] = value[chosen]
        return cls(**values)

    @staticmethod
    def _of_robot(robot):
        values = {
            "names": tuple(robot.parameter_names_),
            "units": tuple(robot.parameter_units_),
            "estimate": np.array(robot.theta_, dtype=float),
            "std": np.array(robot.theta_std_, dtype=float),
            "identifiable": np.array(robot.identifiable_, dtype=bool),
        }
        if robot.projector_ is not None:
            values["second"] = np.array(robot.theta_unconstrained_, dtype=float)
            values["interval_of"] = "second"
            values["labels"] = {
                "estimate": "projected",
                "second": "before the projection",
            }
        return values

    @classmethod
    def _of_regressor(cls, regressor, units):
        cls._require(regressor, ("coef_", "n_features_in_"))
        coef = np.array(regressor.coef_, dtype=float)
        count = regressor.n_features_in_
        if coef.shape != (count,):
            raise ValueError(
                f"ParameterDisplay shows coefficients of one output, shape ({count},); "
                f"got {coef.shape} from {type(regressor).__name__}."
            )
        values = {
            "names": _input_names(regressor),
            "units": ("",) * count
            if units is None
            else _check_units(units, count, "each coefficient"),
            "estimate": coef,
        }
        labels = {"estimate": "coefficient"}
        for key, attribute, kind in (
            ("std", "coef_std_", float),
            ("second", "coef_noisy_", float),
            ("identifiable", "relevant_", bool),
        ):
            if getattr(regressor, attribute, None) is not None:
                values[key] = np.array(getattr(regressor, attribute), dtype=kind)
        if "second" in values:
            labels |= {"estimate": "noiseless queries", "second": "noisy queries"}
        values["labels"] = labels | {"open": "not relevant"}
        return values

    @property
    def panels(self):
        """Panels, a list of (joint, unit, list of parameter numbers)."""
        found = {}
        for i, (name, unit) in enumerate(zip(self.names, self.units)):
            found.setdefault((_joint(name), unit), []).append(i)
        panels = [(*panel, rows) for panel, rows in found.items()]
        # A joint's panels beside each other, wherever its effects stand in theta.
        return [panel for line in _by_joint(panels) for panel in line]

    def plot(self, ax=None, *, level=0.95, line_kwargs=None, interval_kwargs=None):
        """Draw.

        Parameters
        ----------
        ax : Axes or array-like of Axes, default=None
            One for each of `panels`; None makes a figure, in which panels of more
            than 36 parameters continue in further axes.
        level : float, default=0.95
            Probability of the intervals (normal distribution).
        line_kwargs : dict, default=None
            What matplotlib's ``plot`` gets for the marks of the estimates.
        interval_kwargs : dict, default=None
            What matplotlib's ``hlines`` gets for the intervals.

        Returns
        -------
        self : object
            With `figure_`, `axes_`, `lines_` and `intervals_`.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If the axes do not match, or `level` is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ValueError(f"level must be between 0 and 1; got {level!r}.")
        panels, place = self.panels, {}
        shape = (len(panels), 1)
        if ax is None:
            panels = [
                (joint, unit, piece)
                for joint, unit, rows in panels
                for piece in _split_rows(rows)
            ]
            shape, place = self._grid(panels)
        self._open(ax, [shape], "one a joint and unit, see panels", **place)
        if ax is None:
            self._keep_used(panels, shape)
        styles = line_kwargs or {}, interval_kwargs or {}
        self.lines_, self.intervals_ = [], []
        for axis, (joint, unit, rows) in zip(self.axes_, panels):
            self._panel(axis, np.array(rows), level, *styles)
            axis.set_title(joint, fontsize="small", loc="left")
            bare = "no unit" if joint else "coefficient"
            axis.set_xlabel(f"[{unit}]" if unit else bare, fontsize="small")
        _share_limits(self.axes_, [panel[:2] for panel in panels])
        for axis in self.axes_:
            low, high = axis.get_xlim()
            if low < 0.0 < high:
                axis.axvline(0.0, color="0.8", lw=0.8, zorder=0)
        self._close(ax, least=2)
        return self

    def _grid(self, panels):
        """Shape of a grid with a row of axes for each joint, and where they are."""
        lines = _by_joint(panels)
        heights = [
            _ROW * max(len(rows) for *_, rows in line) + _AROUND for line in lines
        ]
        columns = list(zip_longest(*lines))
        width = sum(
            1.85
            + max(_name_width(self._row_names(panel[2])) for panel in column if panel)
            for column in columns
        )
        size = (max(width, 5.5), max(sum(heights) + 0.5, 2.2))
        return (len(lines), len(columns)), {"figsize": size, "height_ratios": heights}

    def _keep_used(self, panels, shape):
        """Remove the axes of the grid that no panel uses."""
        used = [
            axis
            for line, axes in zip(_by_joint(panels), self.axes_.reshape(shape))
            for axis in axes[: len(line)]
        ]
        for axis in set(self.axes_) - set(used):
            axis.remove()
        self.axes_ = np.array(used, dtype=object)

    def _row_names(self, rows):
        """Names without the joint, which the panel says."""
        return [self.names[i].partition(":")[2] or self.names[i] for i in rows]

    def _label(self, key, level):
        usual = {
            "estimate": "estimate",
            "second": "second estimate",
            "nominal": "nominal",
            "open": "not identifiable alone",
            "interval": f"{100 * level:g} % interval",
        }
        return (usual | (self.labels or {}))[key]

    def _panel(self, ax, rows, level, line_style, interval_style):
        place = np.arange(rows.size, dtype=float)
        known = np.ones(rows.size, dtype=bool)
        if self.identifiable is not None:
            known = np.asarray(self.identifiable, dtype=bool)[rows]
        two = self.second is not None
        # Two estimates side by side, or each would hide the other.
        shift = {"estimate": -0.17 if two else 0.0, "second": 0.17}
        marks = {"ls": "", "marker": "|", "ms": 11, "mew": 2, "color": "black"}
        if self.nominal is not None:
            values = np.asarray(self.nominal, dtype=float)[rows]
            label = self._label("nominal", level)
            self.lines_ += ax.plot(values, place, zorder=2, label=label, **marks)
        self._intervals(
            ax, rows, place + shift[self.interval_of], level, interval_style
        )
        drawn = [("estimate", self.estimate, "o", _COLOUR)]
        if two:
            drawn.append(("second", self.second, "D", _SECOND))
        for key, values, marker, colour in drawn:
            values = np.asarray(values, dtype=float)[rows]
            marks = {"ls": "", "marker": marker, "ms": 4.5, "zorder": 3}
            hollow = {"mfc": "white", "mec": colour, "label": "_hollow " + key}
            full = {"color": colour, "label": self._label(key, level)}
            for chosen, style in ((known, full), (~known, hollow)):
                if chosen.any() or style is full:
                    x, y = values[chosen], (place + shift[key])[chosen]
                    self.lines_ += ax.plot(x, y, **marks | style | line_style)
        if not known.all():
            # The legend says it once, in grey, for both estimates.
            marks = {"ls": "", "marker": "o", "mfc": "white", "mec": "0.55"}
            ax.plot([], [], label=self._label("open", level), **marks)
        _label_rows(ax, self._row_names(rows), muted=~known)
        ax.ticklabel_format(axis="x", scilimits=(-2, 3), useMathText=True)
        ax.locator_params(axis="x", nbins=4)
        ax.tick_params(axis="x", labelsize="small")
        ax.xaxis.get_offset_text().set_fontsize("small")
        ax.margins(x=0.08)

    def _intervals(self, ax, rows, place, level, style):
        if self.std is None:
            return
        second = self.interval_of == "second"
        middle = np.asarray(self.second if second else self.estimate, float)[rows]
        half = stats.norm.ppf(0.5 + 0.5 * level) * np.asarray(self.std, float)[rows]
        drawn = np.isfinite(half) & np.isfinite(middle)
        if not drawn.any():
            return
        usual = {"color": _SECOND if second else _COLOUR, "lw": 1.6, "alpha": 0.6}
        usual |= {"zorder": 2, "label": self._label("interval", level)}
        ends = (middle - half)[drawn], (middle + half)[drawn]
        self.intervals_.append(ax.hlines(place[drawn], *ends, **usual | style))


def _by_joint(panels):
    """Panels of each joint, a list of lists."""
    joints = dict.fromkeys(joint for joint, *_ in panels)
    return [[panel for panel in panels if panel[0] == joint] for joint in joints]


def _joint(name):
    """Part of a name before the colon."""
    joint, colon, _ = name.partition(":")
    return joint if colon else ""


def _check_nominal(nominal, count):
    value = np.array(nominal, dtype=float)
    if value.shape != (count,):
        raise ValueError(
            f"nominal must hold {count} values, one a parameter, nan where there is "
            f"none; got shape {value.shape}."
        )
    return value


def _is_bool(value):
    return isinstance(value, (bool, np.bool_))


def _select(parameters, names):
    """Numbers of the chosen parameters, in their order."""
    if parameters is None:
        return np.arange(len(names))
    single = isinstance(parameters, (str, int, np.integer))
    entries = [parameters] if single else list(parameters)
    mask = np.zeros(len(names), dtype=bool)
    if len(entries) == len(names) and all(map(_is_bool, entries)):
        mask[:] = entries
        entries = []
    for entry in entries:
        found = []
        if isinstance(entry, str):
            found = [i for i, n in enumerate(names) if entry in (n, _joint(n))]
        elif isinstance(entry, (int, np.integer)) and not _is_bool(entry):
            found = [int(entry)] if 0 <= entry < len(names) else []
        if not found:
            raise ValueError(
                f"parameters must be names, joints, numbers from 0 to "
                f"{len(names) - 1} or a mask of {len(names)}; got {entry!r}."
            )
        mask[found] = True
    if not mask.any():
        raise ValueError("parameters must choose at least one; got none.")
    return np.flatnonzero(mask)


class NoiseDisplay(Display):
    """Identified input and output noise.

    One row a joint (of an identifier) or an input (of a regressor), one panel a unit.

    Parameters
    ----------
    noise : dict of str to array-like of shape (n,)
        What is shown of each row, by its label; nan is not drawn.
    units : dict of str to sequence of n str
        Unit of each number, with the same keys. Rows of different units are in
        different panels.
    names : sequence of n str
        Names of the rows.
    at_zero : array-like of shape (n,), bool, default=None
        Rows whose noise went to zero (Heywood cases), which are marked.

    Attributes
    ----------
    figure_ : matplotlib Figure
        Figure, after `plot`.
    axes_ : ndarray of Axes, shape (n_units,)
        Axes, after `plot`, in the order of `panels`.
    lines_ : list of matplotlib Line2D
        Marks of each label of each panel, after `plot`.

    See Also
    --------
    NoiseDisplay.from_estimator : Make one from a fitted model.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa import VBJFARegressor
    >>> from sklearn_vbjfa.diagnosis import NoiseDisplay
    >>> rng = np.random.default_rng(0)
    >>> t = rng.normal(size=(2000, 2))
    >>> y = t @ [1.0, -2.0] + 0.1 * rng.normal(size=2000)
    >>> X = t + 0.5 * rng.normal(size=t.shape)  # a fifth of each input is noise
    >>> model = VBJFARegressor(input_noise=[0.25, 0.25]).fit(X, y)
    >>> display = NoiseDisplay.from_estimator(model)
    >>> display.names
    ('x0', 'x1', 'output')
    >>> display.noise["noise"][:2].round(1)
    array([0.2, 0.2])
    """

    _accepts = (
        "a RobotIdentifier, an EffectDiscovery or a regressor that identifies noise "
        "(VBJFARegressor, JFARegressor)"
    )

    def __init__(self, *, noise, units, names, at_zero=None):
        self.noise = noise
        self.units = units
        self.names = names
        self.at_zero = at_zero

    @classmethod
    def from_estimator(cls, estimator, *, units=None):
        """Show the noise that a fitted model found.

        Of a robot: the standard deviations `torque_noise_`, `input_noise_torque_`,
        `noise_floor_` and `output_noise_` [N m or N], and that of the positions
        [rad or m] where they were given. Of a regressor: `input_noise_` (the diagonal
        of a covariance) and `output_noise_`.

        Parameters
        ----------
        estimator : RobotIdentifier, EffectDiscovery, VBJFARegressor or JFARegressor
            Fitted; of a discovery the completed model is shown. Any regressor with
            `input_noise_` and `output_noise_` will do.
        units : sequence of n_features + 1 str, default=None
            Units of a regressor's inputs and its output; the noise is then shown as
            standard deviations. None shows shares of the variances, which have no
            unit; an input of an uncentred model (``fit_intercept=False``) by its mean
            square.

        Returns
        -------
        NoiseDisplay
            Display; call `plot`.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the estimator is not fitted.
        ValueError
            If it has no noise to show, or `units` does not match.
        """
        robot = fitted_robot(estimator)
        if robot is None:
            return cls._of_regressor(estimator, units)
        _refuse_units(units, estimator, "joints have units of their own")
        return cls._of_robot(robot)

    @classmethod
    def _of_robot(cls, robot):
        prismatic = is_prismatic(robot.features_.model_)
        torque = tuple("N" if kind else "N m" for kind in prismatic)
        noise = {
            "output noise": robot.output_noise_,
            "noise floor": robot.noise_floor_,
            "torque noise": robot.torque_noise_,
            "input noise": robot.input_noise_torque_,
        }
        units = dict.fromkeys(noise, torque)
        if robot.state_estimator_ is not None:
            noise["position noise"] = np.sqrt(robot.state_estimator_.noise_variance_)
            units["position noise"] = tuple("m" if k else "rad" for k in prismatic)
        noise = {label: np.array(v, dtype=float) for label, v in noise.items()}
        return cls(noise=noise, units=units, names=tuple(robot.joint_names_))

    @classmethod
    def _of_regressor(cls, regressor, units):
        cls._require(regressor, ("input_noise_", "output_noise_", "n_features_in_"))
        inputs = np.asarray(regressor.input_noise_, dtype=float)
        if inputs.ndim == 2:
            inputs = np.diagonal(inputs)
        variance = np.append(inputs, float(regressor.output_noise_))
        if units is None:
            values = variance / cls._variances(regressor)
            units = (_SHARE,) * variance.size
        else:
            values = np.sqrt(variance)
            units = _check_units(units, variance.size, "each input and the output")
        return cls(
            noise={"noise": values},
            units={"noise": units},
            names=(*_input_names(regressor), "output"),
        )

    @staticmethod
    def _variances(regressor):
        """Variances of the inputs and the output; nan of what is constant."""
        stats = getattr(regressor, "statistics_", None)
        if stats is None:
            raise ValueError(
                f"This {type(regressor).__name__} was fitted to fewer samples than "
                "features and keeps no variances, of which the noise could be a "
                "share: give units, for standard deviations."
            )
        scatter = stats.scatter_about(centred=regressor.fit_intercept)
        found = np.diagonal(scatter) / stats.n_samples
        return np.where(found > 0, found, np.nan)

    @property
    def panels(self):
        """Rows of each panel, a dict of unit to ndarray of row numbers."""
        rows = {}
        for units in self.units.values():
            for i, unit in enumerate(units):
                rows.setdefault(unit, set()).add(i)
        return {unit: np.array(sorted(found)) for unit, found in rows.items()}

    def plot(self, ax=None, *, log="auto", line_kwargs=None):
        """Draw.

        Parameters
        ----------
        ax : Axes or array-like of Axes, default=None
            One for each of `panels`; None makes a figure.
        log : "auto" or bool, default="auto"
            Whether the axes are logarithmic, which shows no zeros. "auto": where all
            values of a panel are positive and differ by more than a factor of 20.
        line_kwargs : dict, default=None
            What matplotlib's ``plot`` gets for the marks.

        Returns
        -------
        self : object
            With `figure_`, `axes_` and `lines_`.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If the axes do not match.
        """
        panels = list(self.panels.items())
        contents = f"one a unit ({', '.join(unit for unit, _ in panels)})"
        if ax is None:
            panels = [(u, piece) for u, rows in panels for piece in _split_rows(rows)]
        width = (3.3 + _name_width(self.names)) * len(panels)
        most = max(rows.size for _, rows in panels)
        height = (0.18 if len(self.noise) == 1 else 0.36) * most + 1.4
        shapes = [(1, len(panels))]
        self._open(ax, shapes, contents, figsize=(max(width, 5.6), height))
        self.lines_ = []
        for axis, (unit, rows) in zip(self.axes_, panels):
            logarithmic = self._is_logarithmic(unit, log)
            self._panel(axis, unit, rows, logarithmic, line_kwargs or {})
        _share_limits(self.axes_, [unit for unit, _ in panels])
        self._close(ax, least=2)
        return self

    def _values(self, label, unit, rows):
        """Numbers of a label in a unit, and in which of the rows they stand."""
        mine = np.array([i for i in rows if self.units[label][i] == unit], dtype=int)
        values = np.asarray(self.noise[label], dtype=float)[mine]
        return values, np.searchsorted(rows, mine)

    def _panel(self, ax, unit, rows, logarithmic, style):
        found = [
            (k, *self._values(label, unit, rows)) for k, label in enumerate(self.noise)
        ]
        # What is unknown in every row has no place beside the others, nor a legend.
        found = [entry for entry in found if np.isfinite(entry[1]).any()]
        for i, (k, values, place) in enumerate(found):
            marks = {
                "ls": "",
                "marker": _MARKERS[k % len(_MARKERS)],
                "ms": 5,
                "color": _NOISE_COLOURS[k % len(_NOISE_COLOURS)],
                "label": list(self.noise)[k],
            }
            # Side by side: what is nearly equal would hide each other.
            shift = 0.8 * ((i + 0.5) / len(found) - 0.5)
            self.lines_ += ax.plot(values, place + shift, **marks | style)
        top = max((np.nanmax(entry[1]) for entry in found), default=0.0)
        if logarithmic:
            ax.set_xscale("log")
        else:
            ax.set_xlim(np.array([-0.03, 1.06]) * (top if top > 0 else 1.0))
            ax.ticklabel_format(axis="x", scilimits=(-3, 4), useMathText=True)
            ax.locator_params(axis="x", nbins=5)
        self._mark_zeros(ax, rows)
        _label_rows(ax, [self.names[i] for i in rows])
        share = unit == _SHARE
        ax.set_xlabel(f"noise, {unit}" if share else f"standard deviation [{unit}]")

    def _is_logarithmic(self, unit, log):
        if log != "auto":
            return bool(log)
        rows = self.panels[unit]
        found = np.concatenate([self._values(k, unit, rows)[0] for k in self.noise])
        found = found[np.isfinite(found)]
        positive = found.size > 0 and found.min() > 0
        return bool(positive and found.max() > _LOG_RATIO * found.min())

    def _mark_zeros(self, ax, rows):
        if self.at_zero is None:
            return
        found = np.flatnonzero(np.asarray(self.at_zero)[rows])
        if found.size:
            # At the left edge, where a logarithmic axis has them too.
            ax.plot(
                np.full(found.size, 0.0),
                found,
                ls="",
                marker="x",
                ms=8,
                mew=2,
                color="tab:red",
                transform=ax.get_yaxis_transform(),
                clip_on=False,
                label="went to zero (Heywood case)",
            )


# -- rows -----------------------------------------------------------------------------


def _input_names(regressor):
    """Names of a regressor's inputs, x0, x1, ... where it got none."""
    names = getattr(regressor, "feature_names_in_", None)
    if names is None:
        names = [f"x{j}" for j in range(regressor.n_features_in_)]
    return tuple(str(name) for name in names)


def _check_units(units, count, what):
    """Return a tuple of unit strings, one for each of `count` entries."""
    found = (units,) if isinstance(units, str) else tuple(units)
    if len(found) != count or not all(isinstance(unit, str) for unit in found):
        raise ValueError(
            f"units must hold {count} strings, one for {what}; got {units!r}."
        )
    return found


def _refuse_units(units, estimator, what):
    """Refuse units for what a robot knows itself."""
    if units is not None:
        raise ValueError(
            f"units must be None for {type(estimator).__name__}, whose {what}; got "
            f"{units!r}."
        )


def _label_rows(ax, names, *, muted=None):
    """Write one name a row on the vertical axis, the first on top; muted ones grey."""
    ax.set_yticks(np.arange(len(names)), names, fontsize="small")
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.grid(axis="y", color="0.92", lw=0.8)
    ax.set_axisbelow(True)
    ax.tick_params(axis="y", length=0)
    if muted is not None:
        for label, grey in zip(ax.get_yticklabels(), muted):
            label.set_color("0.55" if grey else "black")


def _name_width(names):
    """Width that the longest of some row names takes [inch]."""
    return 0.075 * max(map(len, names))


def _split_rows(rows):
    """Split rows into as few equally long pieces as a new figure needs."""
    rows = np.asarray(rows)
    return np.array_split(rows, max(1, -(-rows.size // _MOST_ROWS)))


def _share_limits(axes, panels):
    """Give axes whose entries in `panels` are equal the same horizontal limits."""
    together = {}
    for ax, panel in zip(axes, panels):
        together.setdefault(panel, []).append(ax)
    for group in together.values():
        # An axis of its own keeps the limits that grow with what is drawn next.
        if len(group) > 1:
            limits = np.array([ax.get_xlim() for ax in group])
            for ax in group:
                ax.set_xlim(limits.min(), limits.max())
