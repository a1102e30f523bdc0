"""Identify a robot with FIGAROH 1.x, as its documentation and examples do.

Run as ``python figaroh_user.py DECIMATION STANDSTILL`` in a folder with robot.urdf,
fitted.npz, held_out.npz and settings.yaml; writes predicted.npy.
"""

import sys

import numpy as np
from figaroh.data.trajectory import JOINT_TORQUE, TrajectoryData
from figaroh.identification.base_identification import BaseIdentification
from figaroh.tools.robot import load_robot

DECIMATION, STANDSTILL = int(sys.argv[1]), float(sys.argv[2])
# Filters and differences are wrong this close to the ends of a recording [s].
BORDER = 0.1


class Identification(BaseIdentification):
    def __init__(self, robot, config_file):
        super().__init__(robot, config_file)
        names = self.identif_config["active_joints"]
        joints = [self.model.joints[self.model.getJointId(name)] for name in names]
        self.identif_config["act_idxq"] = [joint.idx_q for joint in joints]
        self.identif_config["act_idxv"] = [joint.idx_v for joint in joints]

    def load_trajectory_data(self, data_source=None):
        part = np.load(data_source or "fitted.npz")
        q, dt, labels = part["q"], float(part["dt"]), part["groups"]
        self.recordings = [np.flatnonzero(labels == x) for x in np.unique(labels)]
        self.moving = np.zeros(q.shape, dtype=bool)
        border = round(BORDER / dt)
        for rows in self.recordings:
            speed = np.abs(np.gradient(q[rows], dt, axis=0))
            inner = slice(border, len(rows) - border)
            self.moving[rows[inner]] = speed[inner] > STANDSTILL
        return TrajectoryData(
            t=dt * np.arange(len(q)),
            clock="assumed",
            joint_names=self.identif_config["active_joints"],
            q=q,
            effort=part["tau"],
            effort_kind=JOINT_TORQUE,
            effort_unit="N m",
            mask=self.moving.any(axis=1),
        )

    def filter_kinematics_data(self, filter_config=None):
        # Nothing is filtered or differentiated from one recording into the next.
        whole, pieces = self.raw_data, []
        for rows in self.recordings:
            self.raw_data = {k: x[rows] for k, x in whole.items() if x is not None}
            super().filter_kinematics_data(filter_config)
            pieces.append(self.processed_data)
        self.raw_data = whole
        self.processed_data = {
            k: np.concatenate([piece[k] for piece in pieces]) for k in pieces[0]
        }


def run(kind):
    identification = kind(load_robot("robot.urdf", package_dirs="."), "settings.yaml")
    identification.initialize()
    identification.solve(
        decimate=True, decimation_factor=DECIMATION, plotting=False, wls=True
    )
    for insight in identification.verify().insights:
        print("*", insight)
    torques = identification.result["validation_metrics"]["tau_identified_per_joint"]
    np.save("predicted.npy", np.column_stack(list(torques.values())))


if __name__ == "__main__":
    run(Identification)
