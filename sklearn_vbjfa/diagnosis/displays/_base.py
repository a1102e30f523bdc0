"""What the displays share: whose numbers they show, axes, legends."""

import importlib

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_vbjfa.diagnosis._discovery import EffectDiscovery
from sklearn_vbjfa.robot._identifier import RobotIdentifier

# Most rows of one panel; a longer one goes on in further axes.
MOST_ROWS = 36


def fitted_robot(estimator):
    """Return the fitted RobotIdentifier, for a discovery its completed model.

    Parameters
    ----------
    estimator : object
        What the user gave to a display.

    Returns
    -------
    RobotIdentifier or None
        None if the estimator holds no robot.

    Raises
    ------
    TypeError
        If it is no estimator instance.
    sklearn.exceptions.NotFittedError
        If it is not fitted.
    """
    check_is_fitted(estimator)
    if isinstance(estimator, EffectDiscovery):
        return estimator.identifier_
    return estimator if isinstance(estimator, RobotIdentifier) else None


def check_attributes(estimator, attributes, display, accepted):
    """Refuse a fitted estimator that has not what the display shows."""
    missing = [name for name in attributes if not hasattr(estimator, name)]
    if missing:
        raise ValueError(
            f"{display} shows {accepted}; got {type(estimator).__name__}, which has "
            f"no {', '.join(missing)}."
        )


def input_names(regressor):
    """Names of a regressor's inputs, x0, x1, ... where it got none."""
    names = getattr(regressor, "feature_names_in_", None)
    if names is None:
        names = [f"x{j}" for j in range(regressor.n_features_in_)]
    return tuple(str(name) for name in names)


def check_units(units, count, what):
    """Return a tuple of unit strings, one for each of `count` entries."""
    found = (units,) if isinstance(units, str) else tuple(units)
    if len(found) != count or not all(isinstance(unit, str) for unit in found):
        raise ValueError(
            f"units must hold {count} strings, one for {what}; got {units!r}."
        )
    return found


def import_pyplot(display):
    """Import matplotlib.pyplot, or say which display needs it."""
    try:
        # By name, so that nothing here imports an optional package.
        return importlib.import_module("matplotlib.pyplot")
    except ImportError as error:
        raise ImportError(
            f"{display}.plot needs matplotlib; install it with "
            'pip install "sklearn-vbjfa[plot]".'
        ) from error


def check_axes(ax, counts, contents):
    """Return given axes as a flat array of one of the lengths in `counts`."""
    axes = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
    if axes.size not in counts:
        expected = " or ".join(str(count) for count in counts)
        raise ValueError(f"ax must hold {expected} axes, {contents}; got {axes.size}.")
    return axes


def put_legend(figure, axes, *, outside, least=1):
    """Make one legend of the artists of all axes, each label once.

    Parameters
    ----------
    figure : matplotlib Figure
        Their figure.
    axes : iterable of Axes
        Axes with labelled artists.
    outside : bool
        Whether above the axes (a figure of one's own), or in the first of them.
    least : int, default=1
        Number of labels from which on a legend says anything.
    """
    entries = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels()):
            entries.setdefault(label, handle)
    if len(entries) < least:
        return
    place = {"handles": list(entries.values()), "labels": list(entries)}
    if outside:
        columns = min(len(entries), max(1, int(figure.get_figwidth() / 2.2)))
        figure.legend(**place, loc="outside upper left", ncols=columns, frameon=False)
    else:
        next(iter(axes)).legend(**place, fontsize="small")


def label_rows(ax, names, *, muted=None):
    """Write one name a row on the vertical axis, the first on top.

    Parameters
    ----------
    ax : Axes
        Where.
    names : sequence of str
        Names of the rows 0, 1, ...
    muted : sequence of bool, default=None
        Rows whose name is grey.
    """
    ax.set_yticks(np.arange(len(names)), names, fontsize="small")
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.grid(axis="y", color="0.92", lw=0.8)
    ax.set_axisbelow(True)
    ax.tick_params(axis="y", length=0)
    if muted is not None:
        for label, grey in zip(ax.get_yticklabels(), muted):
            label.set_color("0.55" if grey else "black")


def name_width(names):
    """Width that the longest of some row names takes [inch]."""
    return 0.075 * max(map(len, names))


def split_rows(rows):
    """Split rows into as few equally long pieces as a figure of one's own needs."""
    rows = np.asarray(rows)
    return np.array_split(rows, max(1, -(-rows.size // MOST_ROWS)))


def share_limits(axes, panels):
    """Give axes of the same panel the same horizontal limits.

    Parameters
    ----------
    axes : sequence of Axes
        Axes.
    panels : sequence
        What each shows, in the same order; equal entries are one panel.
    """
    together = {}
    for ax, panel in zip(axes, panels):
        together.setdefault(panel, []).append(ax)
    for group in together.values():
        if len(group) > 1:
            limits = np.array([ax.get_xlim() for ax in group])
            for ax in group:
                ax.set_xlim(limits.min(), limits.max())
