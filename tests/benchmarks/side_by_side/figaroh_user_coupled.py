"""The same, with the columns of the TX40's coupled wrist from FIGAROH's example."""

import figaroh.identification.base_identification as base
import numpy as np
from figaroh_user import Identification, run

plain_regressor = base.build_regressor_basic


def coupled_regressor(robot, q, v, a, settings):
    plain = plain_regressor(robot, q, v, a, settings)
    columns = np.zeros((6, len(q), 3))
    both = np.sign(v[:, 4] + v[:, 5])
    columns[4] = np.column_stack([a[:, 5], v[:, 5], both])
    columns[5] = np.column_stack([a[:, 4], v[:, 4], both])
    return np.hstack([plain, columns.reshape(-1, 3)])


# The validation builds its regressor by the same function, not by a method.
base.build_regressor_basic = coupled_regressor


class Coupled(Identification):
    def initialize_standard_parameters(self):
        super().initialize_standard_parameters()
        self.standard_parameter.update(Iam6=0.0, fvm6=0.0, fsm6=0.0)


if __name__ == "__main__":
    run(Coupled)
