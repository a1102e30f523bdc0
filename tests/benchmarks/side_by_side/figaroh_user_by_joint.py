"""The same, with the samples of each standing joint left out of its equations."""

from figaroh_user import Identification, run


class ByJoint(Identification):
    def load_trajectory_data(self, data_source=None):
        data = super().load_trajectory_data(data_source)
        if data_source is None:
            self.fitted_rows = self.moving
        return data

    def _mask_rows(self, tau, regressor, factor=1):
        # The mask of TrajectoryData is one for all joints; the joints' equations are
        # blocks of equal length, so that rows become zeros and stay.
        kept = self.fitted_rows[::factor].T.ravel()
        return tau * kept, regressor * kept[:, None]


if __name__ == "__main__":
    run(ByJoint)
