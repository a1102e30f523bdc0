"""Search of a robot with many joints, branch by branch."""

from dataclasses import dataclass, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._posterior import sort_findings
from sklearn_vbjfa.diagnosis.search._stepwise import tune_shapes
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.effects import OfRobot, ToAnother
from sklearn_vbjfa.equations._features import RigidBodyFeatures
from sklearn_vbjfa.equations._states import select_joints
from sklearn_vbjfa.model import joint_names, with_joints

# Robots of up to this many joints are searched as a whole, so that effects may couple
# branches, such as through a common drive.
_MAX_JOINTS = 7
# Fields with a value for each joint: of a fitted robot, of its plan, and (in columns)
# of a recording, in addition to its rows.
_OF_ROBOT = ("noise_floor_", "torque_noise_", "output_noise_", "joint_weights", "waves")
_OF_PLAN = ("standstill", "stops", "fastest_period", "corners")
_OF_RECORDING = ("torque_noise", "feedback")


@dataclass(frozen=True, kw_only=True, eq=False)
class Branch:
    """A branch of a robot as a separate robot."""

    joints: list  # its joints in the robot, ascending
    model: object

    def _part(self, whole, names, axis):
        """Restrict attributes, arrays with an axis of joints or None, a dict."""
        values = {name: getattr(whole, name) for name in names}
        return {
            name: None if value is None else value.take(self.joints, axis)
            for name, value in values.items()
        }

    def robot(self, robot):
        """Restrict a fitted robot without effects to the branch."""
        # Its parameters do not affect the torques of other branches.
        features = RigidBodyFeatures(self.model, friction=robot.features_.friction_)
        plan, fields = robot.plan, self._part(robot, _OF_ROBOT, 0)
        for name in ("theta_", "theta_unconstrained_"):
            by_joint = getattr(robot, name).reshape(len(plan.standstill), -1)
            fields[name] = by_joint[self.joints].ravel()
        changes = self._part(plan, _OF_PLAN, 0)
        if plan.state_estimator is not None:
            estimator = select_joints(plan.state_estimator, self.joints)
            changes["state_estimator"] = estimator
        fields |= {"features_": features.load(), "plan": replace(plan, **changes)}
        return replace(robot, **fields)

    def recording(self, recording):
        """Restrict a recording to the joints of the branch."""
        rows = [name for name, width in recording.WIDTHS.items() if width == 1]
        columns = self._part(recording, (*_OF_RECORDING, *rows), -1)
        if recording.states is not None:
            states = recording.states.reshape(recording.n_samples, 3, -1)
            columns["states"] = states[:, :, self.joints].reshape(len(states), -1)
        columns["before"] = tuple(q[:, self.joints] for q in recording.before)
        for name in ("joint_names", "position_units", "torque_units"):
            all_joints = getattr(recording, name)
            columns[name] = tuple(all_joints[j] for j in self.joints)
        return replace(recording, **columns)

    def view(self, robot, recording, **keywords):
        """Return the `RecordingView` of the branch of a fitted robot."""
        return RecordingView(self.robot(robot), self.recording(recording), **keywords)

    def on_robot(self, effect):
        """Renumber the joints of an effect of the branch as in the robot."""
        if isinstance(effect, OfRobot):
            return effect
        shape = effect.get_params(deep=False)
        names = {"joint", "other"} if isinstance(effect, ToAnother) else {"joint"}
        moved = {name: self.joints[shape[name]] for name in names}
        return clone(effect).set_params(**moved)


def root_joints(model):
    """Return the first joint of the branch of each joint, ndarray of shape (nv,)."""
    return np.array([model.supports[j][1] - 1 for j in range(1, model.njoints)])


def branches_of(robot, library, max_effects):
    """Return the branches to search separately, or the whole robot, as a list."""
    # A limit on the number of effects, declared effects, and custom effects, which may
    # depend on any joint, require a search of the whole robot.
    model = robot.features_.model_
    root = root_joints(model)
    roots = np.unique(root)
    packages = [type(effect).__module__.split(".")[0] for effect in library]
    if (
        model.nv <= _MAX_JOINTS
        or roots.size == 1
        or max_effects is not None
        or robot.effects_
        or set(packages) != {__name__.split(".")[0]}
    ):
        return [Branch(joints=list(range(model.nv)), model=model)]
    branches, names = [], joint_names(model)
    for first in roots:
        joints = [int(k) for k in np.flatnonzero(root == first)]
        part = with_joints(model, [names[j] for j in joints])
        branches.append(Branch(joints=joints, model=part))
    return branches


def merge_branches(view, motion, branches, results):
    """Merge the results of branches, list of SearchResult."""
    findings, residual = {}, np.zeros_like(view.target)
    for branch, result in zip(branches, results):
        residual[branch.joints] = result.residual
        for finding in result.findings:
            effect = branch.on_robot(finding.effect)
            rivals = tuple(map(branch.on_robot, finding.rivals))
            finding = replace(finding, effect=effect, rivals=rivals)
            # Several branches may have an effect of the whole robot.
            findings.setdefault(effect.key(), finding)
    return replace(
        results[0],
        findings=sort_findings(findings.values()),
        view=view,
        motion=motion,
        residual=residual,
        n_candidates=sum(result.n_candidates for result in results),
        fit=None,
        branches=tuple(zip(branches, results)),
    )


def tune_branch_shapes(merged, view_of):
    """Refit the shapes of effects to another recording, branch by branch."""
    # view_of: returns the `RecordingView` of a branch in that recording.
    final = {}
    for branch, result in merged.branches:
        if result.effects:
            tuned = tune_shapes(view_of(branch), result.effects, result.settings)
            for before, after in zip(result.effects, tuned):
                final.setdefault(branch.on_robot(before).key(), branch.on_robot(after))
    return tuple(final[effect.key()] for effect in merged.effects)
