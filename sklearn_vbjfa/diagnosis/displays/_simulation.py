"""Measured and simulated motion, window by window."""

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
from sklearn_vbjfa.diagnosis.displays._base import Display
from sklearn_vbjfa.robot._identifier import RobotIdentifier
from sklearn_vbjfa.robot._robot import IdentifiedRobot
from sklearn_vbjfa.robot._windows import simulate_windows

# Most windows of a figure of one's own: more are no longer told apart.
_MOST_WINDOWS = 16
# What runs away may leave the measured range by this share of it, and is cut off there.
_MARGIN = 0.6
# Positions that hardly move have at least this range [degrees or mm].
_SMALLEST = 0.1
_COLOURS = ("tab:orange", "tab:blue", "tab:green", "tab:purple")
_MEASURED, _BORDER, _FAILED = "0.25", "0.85", "tab:red"


class SimulationDisplay(Display):
    """Measured and simulated positions over windows, joint by joint.

    One row a joint. Every window begins at its vertical line, at the measured state;
    the errors beside a joint's name are root mean squares over all windows that were
    simulated to their end. Windows that were not are shaded, and counted below. A star
    marks errors that are not clearly smaller than those of a robot that stays and of
    one that keeps its velocity (`SimulatedWindows.clearly_better`).

    Parameters
    ----------
    windows : dict of str to SimulatedWindows
        Simulations of the same windows; the keys become labels.

    Attributes
    ----------
    figure_ : matplotlib Figure
        Figure, after `plot`.
    axes_ : ndarray of Axes, shape (nv,)
        Axes, after `plot`.
    measured_lines_ : list of matplotlib Line2D
        Measured positions, one line a joint, after `plot`.
    lines_ : list of matplotlib Line2D
        Simulated positions, one line a joint for each label in turn, after `plot`.

    See Also
    --------
    SimulationDisplay.from_estimator : Make one from a robot and a recording.
    simulate_windows : Simulates the windows.

    Examples
    --------
    >>> from sklearn_vbjfa import RobotIdentifier
    >>> from sklearn_vbjfa.datasets import load_demo_recording
    >>> from sklearn_vbjfa.diagnosis import SimulationDisplay
    >>> recording = load_demo_recording().select(0)
    >>> robot = RobotIdentifier(
    ...     recording.urdf, dt=recording.dt, friction=("viscous", "coulomb")
    ... )
    >>> robot = robot.fit(recording.q[:3000], recording.tau[:3000])
    >>> display = SimulationDisplay.from_estimator(
    ...     robot, recording.q[3000:], recording.tau[3000:], window=0.5
    ... )
    >>> display.windows["simulated"].n_windows
    9
    """

    _accepts = "a RobotIdentifier, an IdentifiedRobot or an EffectDiscovery"

    def __init__(self, *, windows):
        self.windows = windows

    @classmethod
    def from_estimator(
        cls, estimator, X, y, groups=None, t=None, *, window=1.0, signals=None
    ):
        """Simulate windows of a recording.

        Parameters
        ----------
        estimator : RobotIdentifier, IdentifiedRobot or EffectDiscovery
            Fitted; a discovery shows the declared and the completed model.
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Measured joint positions [rad or m], or states.
        y : array-like of shape (n_samples, nv)
            Measured torques [N m or N].
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings.
        t : array-like of shape (n_samples,), default=None
            Time [s] on the clock of the fit, for effects that vary with time.
        window : float, default=1.0
            Length of a window [s].
        signals : mapping of str to array-like of shape (n_samples,), default=None
            Columns recorded beside the motion, for effects that vary with them.

        Returns
        -------
        SimulationDisplay
            Display; call `plot`.

        Raises
        ------
        ValueError
            As `simulate_windows` does.
        """
        windows, first = {}, None
        for label, robot in cls._robots(estimator).items():
            windows[label] = simulate_windows(
                robot, X, y, groups, t, window=window, signals=signals, beside=first
            )
            first = first or windows[label]
        return cls(windows=windows)

    @classmethod
    def _robots(cls, estimator):
        """Return what is simulated, by its label."""
        if isinstance(estimator, IdentifiedRobot):
            return {"simulated": estimator}
        if not isinstance(estimator, (RobotIdentifier, EffectDiscovery)):
            raise TypeError(
                f"{cls.__name__} shows {cls._accepts}; got {type(estimator).__name__}."
            )
        check_is_fitted(estimator)
        if isinstance(estimator, RobotIdentifier):
            return {"simulated": estimator}
        robots = {"declared model": estimator.declared_}
        if estimator.added_:
            robots["with the four plain terms"] = estimator.plain_
        return {**robots, "completed model": estimator.identifier_}

    def plot(self, ax=None, *, shown=None, measured_kwargs=None, line_kwargs=None):
        """Draw.

        Parameters
        ----------
        ax : array-like of Axes, default=None
            One for each joint; None makes a figure.
        shown : slice or sequence of int, default=None
            Numbers of the windows to draw, from zero; None draws the first ones, at
            most 16.
        measured_kwargs, line_kwargs : dict, default=None
            What matplotlib's ``plot`` gets for measured and for simulated positions.

        Returns
        -------
        self : object
            With `figure_`, `axes_`, `measured_lines_` and `lines_`.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If the axes do not match, or no window is shown.
        """
        one = next(iter(self.windows.values()))
        chosen = _chosen(shown, one.n_windows)
        rows = len(one.joint_names)
        self._open(
            ax,
            [(rows, 1)],
            "one for each joint",
            sharex=True,
            figsize=(min(4.5 + 0.45 * chosen.size, 11.0), 1.5 * rows + 1.0),
        )
        self.measured_lines_, self.lines_ = [], []
        for j, axis in enumerate(self.axes_):
            self._joint(axis, j, chosen, measured_kwargs or {}, line_kwargs or {})
        self.axes_[-1].set_xlabel("\n".join(["time [s]", *self._notes()]))
        self._name_artists(chosen)
        if ax is None and chosen.size < one.n_windows:
            low, high = chosen.min() + 1, chosen.max() + 1
            self.figure_.supxlabel(
                f"windows {low} to {high} of {one.n_windows}", fontsize="small"
            )
        self._close(ax)
        return self

    def _joint(self, ax, j, chosen, measured_style, line_style):
        """Draw one joint."""
        one = next(iter(self.windows.values()))
        scale, unit = (1e3, "mm") if one.prismatic[j] else (180 / np.pi, "degrees")
        for k in chosen:
            ax.axvline(one.t[k, 0], color=_BORDER, lw=0.8, zorder=0)
        measured = _joined(one.t, scale * one.positions[..., j], chosen)
        style = {"color": _MEASURED, "lw": 2.4, "alpha": 0.45} | measured_style
        self.measured_lines_ += ax.plot(*measured, **style)
        told = []
        for (label, own), colour in zip(self.windows.items(), self._colours()):
            curve = _joined(own.t, scale * own.simulated[..., j], chosen)
            style = {"color": colour, "lw": 1.2} | line_style
            self.lines_ += ax.plot(*curve, **style)
            for k in chosen[own.failed[chosen]]:
                span = own.t[k, 0], own.t[k, -1]
                ax.axvspan(*span, color=_FAILED, alpha=0.12, lw=0, zorder=0)
            errors = scale * own.errors[~own.failed, j]
            size = "none"
            if errors.size:
                star = "" if own.clearly_better[j] else "*"
                size = f"{np.sqrt(np.mean(errors**2)):.3g} {unit}{star}"
            told.append(f"{label} {size}" if len(self.windows) > 1 else size)
        low, high = np.nanmin(measured[1]), np.nanmax(measured[1])
        room = _MARGIN * max(high - low, _SMALLEST)
        bottom, top = ax.get_ylim()
        ax.set_ylim(max(bottom, low - room), min(top, high + room))
        ax.set_ylabel(f"[{unit}]")
        ax.set_title(one.joint_names[j], loc="left", fontsize="small")
        text = f"rms error: {', '.join(told)}"
        ax.set_title(text, loc="right", fontsize="small")

    def _notes(self):
        """Say what the star means, and how many windows failed."""
        found = []
        starred = [~own.clearly_better.all() for own in self._simulated()]
        if any(starred):
            found.append("* not clearly better than to stay and to keep the velocity")
        for label, own in self.windows.items():
            if own.failed.any():
                told = f"{own.failed.sum()} of {own.n_windows} windows failed, "
                told += "not in these errors"
                found.append(f"{label}: {told}" if len(self.windows) > 1 else told)
        return found

    def _simulated(self):
        """Return the windows of those of which any was simulated to its end."""
        return [own for own in self.windows.values() if not own.failed.all()]

    def _colours(self):
        """Return one colour for each label."""
        count = len(self.windows)
        if count == 1:
            return _COLOURS[1:2]
        return [_COLOURS[k % len(_COLOURS)] for k in range(count)]

    def _name_artists(self, chosen):
        """Give the legend one entry for each kind of line."""
        ax = self.axes_[0]
        self.measured_lines_[0].set_label("measured")
        for label, line in zip(self.windows, self.lines_):
            line.set_label(label)
        if any(own.failed[chosen].any() for own in self.windows.values()):
            style = {"color": _FAILED, "alpha": 0.3, "lw": 6}
            ax.plot([], [], label="simulation failed", **style)


def _chosen(shown, n_windows):
    """Numbers of the windows to draw, ndarray of int."""
    if shown is None:
        shown = slice(_MOST_WINDOWS)
    if isinstance(shown, slice):
        found = np.arange(n_windows)[shown]
    else:
        found = np.asarray(shown, dtype=int)
    if not found.size or found.min() < 0 or found.max() >= n_windows:
        raise ValueError(
            f"shown must choose some of the windows 0 to {n_windows - 1}; got "
            f"{shown!r}."
        )
    return found


def _joined(t, values, chosen):
    """Join windows to one line, broken between them; its times and values."""
    gap = np.full((chosen.size, 1), np.nan)
    x = np.hstack([t[chosen], gap]).ravel()
    return x, np.hstack([values[chosen], gap]).ravel()
