"""Torque residuals on recordings, filtered as in the fit."""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_vbjfa._core._lowpass import decimate, filter_weight
from sklearn_vbjfa.robot._equations import derivative


@dataclass(frozen=True, kw_only=True)
class TorqueResiduals:
    """Measured and predicted torques after the same low-pass, with weights.

    Attributes
    ----------
    index : ndarray of shape (m,)
        Row of the recording at the centre of each filtered sample.
    torque : ndarray of shape (m, nv)
        Filtered measured torques [N m or N].
    predicted : ndarray of shape (m, nv)
        Torques of the model, from filtered regressor columns [N m or N]. Where the
        weight is zero, dry friction has its mean, see `RobotIdentifier.predict`.
    weight : ndarray of shape (m, nv)
        Zero where a joint is at rest or the sample was left out.
    """

    index: np.ndarray
    torque: np.ndarray
    predicted: np.ndarray
    weight: np.ndarray

    @property
    def residual(self):
        """Measured minus predicted torque [N m or N], ndarray of shape (m, nv)."""
        return self.torque - self.predicted

    def filled(self, other):
        """Take the predictions of another comparison where the weight is zero."""
        counts = self.weight > 0
        return replace(
            self, predicted=np.where(counts, self.predicted, other.predicted)
        )

    def rms(self):
        """Root mean square of the residual of each joint [N m or N]."""
        return _weighted(self.residual**2, self.weight) ** 0.5

    def relative_error(self, spread):
        """Root mean square over a given torque spread (nv,), per joint.

        nan for a joint without weighted samples or without spread.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(spread > 0, self.rms() / spread, np.nan)

    def normalised_error(self):
        """Root mean square over the standard deviation of the torque, per joint.

        nan for a joint without weighted samples or with constant torque.
        """
        return self.relative_error(torque_spread(self))


def torque_spread(*parts):
    """Return the weighted standard deviation of the torque over all parts, (nv,)."""
    # The parts are `TorqueResiduals` of one recording after the same low-pass.
    torque = np.concatenate([part.torque for part in parts])
    weight = np.concatenate([part.weight for part in parts])
    mean = _weighted(torque, weight)
    return _weighted((torque - mean) ** 2, weight) ** 0.5


def compare(segments, lowpasses, theta):
    """Residuals behind each low-pass of `Segment` by parameters (p,), a list."""
    # Torques are predicted before the low-pass, which is linear: a filter of one column
    # of each joint instead of all columns of the regressor. None predicts no torque.
    found = [[] for _ in lowpasses]
    for own in segments:
        torques = [np.asarray(own.torque)]
        torques.append(0 * torques[0] if theta is None else own.rows.predict(theta))
        every = slice(None)
        counts = own.counts(every, derivative(own.states, every, 1))
        for lowpass, pieces in zip(lowpasses, found):
            rows = own.first + lowpass.centres(own.n_rows)
            weight = filter_weight(lowpass, counts)
            pieces.append((rows, *(decimate(lowpass, x) for x in torques), weight))
    return [_joined(pieces) for pieces in found]


def collect_residuals(pieces, theta):
    """Residuals of pieces of `Equations`, which may be an iterator."""
    return _joined((one.index, one.tau, one.Phi @ theta, one.weight) for one in pieces)


def _joined(found):
    """Put residuals (index, torque, predicted, weight) one after the other."""
    index, torque, predicted, weight = (np.concatenate(x) for x in zip(*found))
    return TorqueResiduals(
        index=index, torque=torque, predicted=predicted, weight=weight
    )


def _weighted(values, weight):
    total = weight.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total > 0, (values * weight).sum(axis=0) / total, np.nan)
