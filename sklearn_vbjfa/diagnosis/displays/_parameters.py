"""Estimated parameters with their intervals, beside nominal values."""

import numpy as np
from scipy import stats

from sklearn_vbjfa.diagnosis.displays._base import (
    check_attributes,
    check_axes,
    check_units,
    fitted_robot,
    import_pyplot,
    input_names,
    label_rows,
    name_width,
    put_legend,
    share_limits,
    split_rows,
)

# Height of a row, and of what is around a panel [inch].
_ROW, _AROUND = 0.17, 0.62
_COLOUR, _SECOND, _GREY = "tab:blue", "tab:orange", "0.55"


class ParameterDisplay:
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
        elif units is not None:
            raise ValueError(
                f"units must be None for {type(estimator).__name__}, whose parameters "
                f"say them; got {units!r}."
            )
        else:
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

    @staticmethod
    def _of_regressor(regressor, units):
        check_attributes(
            regressor,
            ("coef_", "n_features_in_"),
            "ParameterDisplay",
            "a RobotIdentifier, an EffectDiscovery or a linear regressor",
        )
        coef = np.array(regressor.coef_, dtype=float)
        count = regressor.n_features_in_
        if coef.shape != (count,):
            raise ValueError(
                f"ParameterDisplay shows coefficients of one output, shape ({count},); "
                f"got {coef.shape} from {type(regressor).__name__}."
            )
        values = {
            "names": input_names(regressor),
            "units": ("",) * count
            if units is None
            else check_units(units, count, "each coefficient"),
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
        # a joint's panels beside each other, wherever its effects stand in theta
        joints = list(dict.fromkeys(joint for joint, _ in found))
        return [
            (joint, unit, rows)
            for wanted in joints
            for (joint, unit), rows in found.items()
            if joint == wanted
        ]

    def plot(self, ax=None, *, level=0.95):
        """Draw.

        Parameters
        ----------
        ax : Axes or array-like of Axes, default=None
            One for each of `panels`; None makes a figure, in which panels of more
            than 36 parameters go on in further axes.
        level : float, default=0.95
            Probability of the intervals (normal distribution).

        Returns
        -------
        self : object
            With `figure_` and `axes_`.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If the axes do not match, or `level` is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ValueError(f"level must be between 0 and 1; got {level!r}.")
        panels = self.panels
        if ax is None:
            panels = [
                (joint, unit, piece)
                for joint, unit, rows in panels
                for piece in split_rows(rows)
            ]
            self.figure_, self.axes_ = _make_grid(panels, self._row_names)
        else:
            self.axes_ = check_axes(
                ax, (len(panels),), "one a joint and unit, see panels"
            )
            self.figure_ = self.axes_[0].figure
        for axis, (joint, unit, rows) in zip(self.axes_, panels):
            self._panel(axis, np.array(rows), level)
            axis.set_title(joint, fontsize="small", loc="left")
            bare = "no unit" if joint else "coefficient"
            axis.set_xlabel(f"[{unit}]" if unit else bare, fontsize="small")
        share_limits(self.axes_, [panel[:2] for panel in panels])
        for axis in self.axes_:
            low, high = axis.get_xlim()
            if low < 0.0 < high:
                axis.axvline(0.0, color="0.8", lw=0.8, zorder=0)
        put_legend(self.figure_, self.axes_, outside=ax is None, least=2)
        return self

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

    def _panel(self, ax, rows, level):
        place = np.arange(rows.size, dtype=float)
        known = np.ones(rows.size, dtype=bool)
        if self.identifiable is not None:
            known = np.asarray(self.identifiable, dtype=bool)[rows]
        two = self.second is not None
        # two estimates side by side, or each would hide the other
        shift = {"estimate": -0.17 if two else 0.0, "second": 0.17}
        if self.nominal is not None:
            ax.plot(
                np.asarray(self.nominal, dtype=float)[rows],
                place,
                ls="",
                marker="|",
                ms=11,
                mew=2,
                color="black",
                zorder=2,
                label=self._label("nominal", level),
            )
        self._intervals(ax, rows, place + shift[self.interval_of], level)
        marks = [("estimate", self.estimate, "o", _COLOUR)]
        if two:
            marks.append(("second", self.second, "D", _SECOND))
        for key, values, marker, colour in marks:
            values = np.asarray(values, dtype=float)[rows]
            style = {"ls": "", "marker": marker, "ms": 4.5, "zorder": 3}
            y = place + shift[key]
            ax.plot(
                values[known],
                y[known],
                color=colour,
                label=self._label(key, level),
                **style,
            )
            if not known.all():
                ax.plot(
                    values[~known],
                    y[~known],
                    mfc="white",
                    mec=colour,
                    label="_hollow " + key,
                    **style,
                )
        if not known.all():
            # the legend says it once, in grey, for both estimates
            ax.plot(
                [],
                [],
                ls="",
                marker="o",
                mfc="white",
                mec=_GREY,
                label=self._label("open", level),
            )
        label_rows(ax, self._row_names(rows), muted=~known)
        ax.ticklabel_format(axis="x", scilimits=(-2, 3), useMathText=True)
        ax.locator_params(axis="x", nbins=4)
        ax.tick_params(axis="x", labelsize="small")
        ax.xaxis.get_offset_text().set_fontsize("small")
        ax.margins(x=0.08)

    def _intervals(self, ax, rows, place, level):
        if self.std is None:
            return
        of = self.second if self.interval_of == "second" else self.estimate
        middle = np.asarray(of, dtype=float)[rows]
        half = stats.norm.ppf(0.5 + 0.5 * level) * np.asarray(self.std, float)[rows]
        drawn = np.isfinite(half) & np.isfinite(middle)
        if drawn.any():
            ax.hlines(
                place[drawn],
                (middle - half)[drawn],
                (middle + half)[drawn],
                color=_SECOND if self.interval_of == "second" else _COLOUR,
                lw=1.6,
                alpha=0.6,
                zorder=2,
                label=self._label("interval", level),
            )


def _joint(name):
    """Part of a name before the colon."""
    joint, colon, _ = name.partition(":")
    return joint if colon else ""


def _make_grid(panels, row_names):
    """Make a figure with a row of axes for each joint; return it and the axes."""
    pyplot = import_pyplot("ParameterDisplay")
    joints = list(dict.fromkeys(joint for joint, _, _ in panels))
    lines = [[p for p in panels if p[0] == joint] for joint in joints]
    heights = [_ROW * max(len(rows) for *_, rows in line) + _AROUND for line in lines]
    columns = max(len(line) for line in lines)
    width = sum(
        1.85 + max(name_width(row_names(line[k][2])) for line in lines if k < len(line))
        for k in range(columns)
    )
    figure = pyplot.figure(
        figsize=(max(width, 5.5), max(sum(heights) + 0.5, 2.2)), layout="constrained"
    )
    grid = figure.add_gridspec(len(lines), columns, height_ratios=heights)
    axes = [
        figure.add_subplot(grid[i, k])
        for i, line in enumerate(lines)
        for k in range(len(line))
    ]
    return figure, np.array(axes, dtype=object)


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
