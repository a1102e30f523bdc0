"""Identified noise of inputs and output, one row an input or a joint."""

import numpy as np

from sklearn_vbjfa.diagnosis.displays._base import (
    Display,
    check_units,
    fitted_robot,
    input_names,
    label_rows,
    name_width,
    refuse_units,
    share_limits,
    split_rows,
)
from sklearn_vbjfa.model import is_prismatic

SHARE = "share of the variance"
# From this ratio of the largest to the smallest value on, a linear axis would hide
# the small ones.
_LOG_RATIO = 20.0
_MARKERS = ("o", "D", "s", "^", "v", "P")
_COLOURS = ("tab:blue", "tab:orange", "tab:green", "0.35", "tab:purple", "tab:brown")


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
        refuse_units(units, estimator, "joints say them")
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
            units = (SHARE,) * variance.size
        else:
            values = np.sqrt(variance)
            units = check_units(units, variance.size, "each input and the output")
        heywood = getattr(regressor, "heywood_", np.zeros(inputs.size, dtype=bool))
        return cls(
            noise={"noise": values},
            units={"noise": units},
            names=(*input_names(regressor), "output"),
            at_zero=np.append(heywood, False),
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
            panels = [(u, piece) for u, rows in panels for piece in split_rows(rows)]
        width = (3.3 + name_width(self.names)) * len(panels)
        most = max(rows.size for _, rows in panels)
        height = (0.18 if len(self.noise) == 1 else 0.36) * most + 1.4
        shapes = [(1, len(panels))]
        self._open(ax, shapes, contents, figsize=(max(width, 5.6), height))
        self.lines_ = []
        for axis, (unit, rows) in zip(self.axes_, panels):
            logarithmic = self._is_logarithmic(unit, log)
            self._panel(axis, unit, rows, logarithmic, line_kwargs or {})
        share_limits(self.axes_, [unit for unit, _ in panels])
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
                "color": _COLOURS[k % len(_COLOURS)],
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
        label_rows(ax, [self.names[i] for i in rows])
        share = unit == SHARE
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
