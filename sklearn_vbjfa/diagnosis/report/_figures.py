"""Figures of an outcome."""

from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._pictures import residual_figure, torque_figure


def torques(outcome):
    """Draw the torque of the worst joints over time, and both residuals below."""
    found = []
    for one in outcome.curves.get("torques", ()):
        own = outcome.errors[one.joint]
        what = "torque" if own.unit == "N m" else "force"
        labels = f"{what} [{own.unit}]", f"residual [{own.unit}]"
        title = words.joint_label(outcome.robot["joints"], one.joint)
        floor = own.floor * own.spread
        found.append(torque_figure(one, floor, title=title, y_labels=labels))
    return found


def residuals(outcome):
    """Draw residuals over the predicted torque, and their autocorrelation."""
    return [
        residual_figure(
            one,
            title=words.joint_label(outcome.robot["joints"], one.joint),
            unit=outcome.errors[one.joint].unit,
        )
        for one in outcome.curves.get("residuals", ())
    ]
