"""The base of the displays: whose numbers they show, axes, rows, legends."""

import importlib

import numpy as np


class Display:
    """A new figure, or the user's axes, and the legend of what is drawn in them."""

    # A display stores its data in the constructor; its `plot` calls `_open`, draws on
    # `axes_` and ends with `_close`. Matplotlib is imported when a figure is made.

    # What `from_estimator` takes, for those who give something else.
    _accepts = ""

    @classmethod
    def _require(cls, estimator, attributes):
        """Refuse a fitted estimator that lacks what the display shows."""
        missing = [name for name in attributes if not hasattr(estimator, name)]
        if missing:
            raise ValueError(
                f"{cls.__name__} shows {cls._accepts}; got {type(estimator).__name__}, "
                f"which has no {', '.join(missing)}."
            )

    def _open(self, ax, shapes, contents, **subplots):
        """Take axes, of one of the shapes, or make a figure; the last shape is its."""
        if ax is None:
            name = type(self).__name__
            figure, axes = _import_pyplot(name).subplots(
                *shapes[-1], squeeze=False, layout="constrained", **subplots
            )
        else:
            axes = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
            if axes.size not in [rows * columns for rows, columns in shapes]:
                expected = " or ".join(
                    f"{r} x {c}" if min(r, c) > 1 else str(r * c) for r, c in shapes
                )
                raise ValueError(
                    f"ax must hold {expected} axes, {contents}; got {axes.size}."
                )
            figure = axes[0].figure
        self.figure_, self.axes_ = figure, axes.ravel()

    def _close(self, ax, *, least=1):
        """Make one legend of the artists of all axes, if it has enough entries."""
        entries = {}
        for axis in self.axes_.flat:
            for handle, label in zip(*axis.get_legend_handles_labels()):
                entries.setdefault(label, handle)
        if len(entries) < least:
            return
        place = {"handles": list(entries.values()), "labels": list(entries)}
        if ax is None:
            room = max(1, int(self.figure_.get_figwidth() / 2.2))
            place |= {"loc": "outside upper left", "frameon": False}
            self.figure_.legend(**place, ncols=min(len(entries), room))
        else:
            self.axes_.flat[0].legend(**place, fontsize="small")


def _import_pyplot(display):
    """Import matplotlib.pyplot, or say which display needs it."""
    try:
        # By name, so that nothing here imports an optional package.
        return importlib.import_module("matplotlib.pyplot")
    except ImportError as error:
        raise ImportError(
            f"{display}.plot needs matplotlib; install it with pip install matplotlib."
        ) from error
