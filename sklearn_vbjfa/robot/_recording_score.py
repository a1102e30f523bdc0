"""Tags and score of the estimators that take whole recordings."""

from sklearn.base import RegressorMixin
from sklearn.metrics import r2_score

from sklearn_vbjfa.robot._joint_columns import torques_in_order


class RecordingRegressorMixin(RegressorMixin):
    """A regressor of several outputs whose rows are recordings in the order of time."""

    def __sklearn_tags__(self):
        """Tags of a regressor with several outputs."""
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        tags.target_tags.single_output = True
        return tags

    def score(self, X, y, sample_weight=None, groups=None, t=None):
        """Coefficient of determination R^2 of the predicted torques.

        Parameters
        ----------
        X : array-like of shape (n_samples, nv) or (n_samples, 3 * nv)
            Joint positions or states.
        y : array-like of shape (n_samples, nv)
            Measured torques [N m or N].
        sample_weight : array-like of shape (n_samples,), default=None
            Weights.
        groups : array-like of shape (n_samples,), default=None
            Labels of separate recordings, as for `predict`.
        t : array-like of shape (n_samples,), default=None
            Time [s], as for `predict`.

        Returns
        -------
        float
            R^2, the mean over the joints.
        """
        predicted = self.predict(X, groups=groups, t=t)
        if hasattr(self, "joint_names_"):
            y = torques_in_order(y, self.joint_names_)
        return r2_score(y, predicted, sample_weight=sample_weight)
