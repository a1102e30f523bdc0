"""A robot of many joints searched branch by branch, and what was found put together."""

from dataclasses import dataclass, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._path import tuned_on
from sklearn_vbjfa.diagnosis.search._posterior import sort_findings
from sklearn_vbjfa.diagnosis.search._view import RecordingView
from sklearn_vbjfa.effects import OfRobot, ToAnother
from sklearn_vbjfa.equations._features import RigidBodyFeatures
from sklearn_vbjfa.equations._states import select_joints
from sklearn_vbjfa.model import import_pinocchio

# A robot of up to this many joints is searched as a whole, in which an effect may join
# two branches, such as a coupling through a common drive: so are arms, and most hands.
_MAX_JOINTS = 7
# Fields of a fitted robot that have a value for each joint.
_BY_JOINT = ("noise_floor_", "torque_noise_", "output_noise_", "joint_weights", "waves")
# Fields of a recording, beside those with rows, that have a column for each joint.
_COLUMNS = ("torque_noise", "feedback")


@dataclass(frozen=True, kw_only=True, eq=False)
class Branch:
    """A branch of a robot as a separate robot."""

    joints: list  # its joints among those of the robot, rising
    model: object

    def robot(self, whole):
        """Return the branch of a fitted robot without effects."""
        # What acts on one branch is all that its parameters were fitted to.
        features = RigidBodyFeatures(self.model, friction=whole.features_.friction_)
        plan, known = whole.plan, {}
        for name in _BY_JOINT:
            value = getattr(whole, name)
            known[name] = None if value is None else value[self.joints]
        for name in ("theta_", "theta_unconstrained_"):
            by_joint = getattr(whole, name).reshape(len(plan.standstill), -1)
            known[name] = by_joint[self.joints].ravel()
        changes = {"standstill": plan.standstill[self.joints]}
        for name in ("stops", "fastest_period", "corners"):
            value = getattr(plan, name)
            changes[name] = None if value is None else value[self.joints]
        if plan.state_estimator is not None:
            estimator = select_joints(plan.state_estimator, self.joints)
            changes["state_estimator"] = estimator
        known |= {"features_": features.load(), "plan": replace(plan, **changes)}
        return replace(whole, **known)

    def recording(self, recording):
        """Return the columns of a recording that belong to the branch."""
        rows = [name for name, width in recording.WIDTHS.items() if width == 1]
        given = {name: getattr(recording, name) for name in (*_COLUMNS, *rows)}
        columns = {
            name: value[..., self.joints]
            for name, value in given.items()
            if value is not None
        }
        if recording.states is not None:
            states = recording.states.reshape(recording.n_samples, 3, -1)
            columns["states"] = states[:, :, self.joints].reshape(len(states), -1)
        columns["before"] = tuple(q[:, self.joints] for q in recording.before)
        for name in ("joint_names", "position_units", "torque_units"):
            whole = getattr(recording, name)
            columns[name] = tuple(whole[j] for j in self.joints)
        return replace(recording, **columns)

    def view(self, whole, recording, leave_out, **known):
        """Return the `RecordingView` of the branch of a fitted robot."""
        mute, own = self.local(leave_out), self.recording(recording)
        return RecordingView(self.robot(whole), own, mute, **known)

    def local(self, joints):
        """Numbers in the branch of those of some joints that belong to it."""
        return [k for k, j in enumerate(self.joints) if j in joints]

    def on_robot(self, effect):
        """Return an effect of the branch as one of the robot."""
        if isinstance(effect, OfRobot):
            return effect
        shape = effect.get_params(deep=False)
        names = {"joint", "other"} if isinstance(effect, ToAnother) else {"joint"}
        moved = {name: self.joints[shape[name]] for name in names}
        return clone(effect).set_params(**moved)


def root_joints(model):
    """First joint of the branch of each joint of a robot, ndarray of shape (nv,)."""
    return np.array([model.supports[j][1] - 1 for j in range(1, model.njoints)])


def branches_of(robot, library, max_effects):
    """Return the branches to search one by one, list of Branch; one is the whole."""
    # Of a fitted declared model. A limit on the number of effects, an effect on a joint
    # that is declared already, and one's own effects, of which nobody knows which
    # joints they look at, ask for the whole robot.
    model = robot.features_.model_
    root = root_joints(model)
    roots = np.unique(root)
    own = [type(effect).__module__.split(".")[0] for effect in library]
    if (
        model.nv <= _MAX_JOINTS
        or roots.size == 1
        or max_effects is not None
        or robot.effects_
        or set(own) != {__name__.split(".")[0]}
    ):
        return [Branch(joints=list(range(model.nv)), model=model)]
    found = []
    for first in roots:
        joints = [int(k) for k in np.flatnonzero(root == first)]
        found.append(Branch(joints=joints, model=_branch_model(model, joints)))
    return found


def _branch_model(model, joints):
    """Build the model of some joints that no other joint carries."""
    pin = import_pinocchio()
    alone = pin.Model()
    alone.name, alone.gravity = model.name, model.gravity
    number = {0: 0}
    for j in joints:
        own = j + 1
        number[own] = alone.addJoint(
            number[int(model.parents[own])],
            model.joints[own],
            model.jointPlacements[own],
            model.names[own],
            model.effortLimit[[j]],
            model.velocityLimit[[j]],
            model.lowerPositionLimit[[j]],
            model.upperPositionLimit[[j]],
        )
        inertia = model.inertias[own]
        alone.appendBodyToJoint(number[own], inertia, pin.SE3.Identity())
    return alone


def put_together(view, motion, branches, found):
    """Put what was `SearchResult` on the branches of a robot together."""
    findings, residual = {}, np.zeros_like(view.target)
    for branch, own in zip(branches, found):
        residual[branch.joints] = own.residual
        for one in own.findings:
            effect = branch.on_robot(one.effect)
            rivals = tuple(map(branch.on_robot, one.rivals))
            one = replace(one, effect=effect, rivals=rivals)
            # What belongs to the whole robot several branches may have found.
            findings.setdefault(effect.key(), one)
    return replace(
        found[0],
        findings=sort_findings(findings.values()),
        view=view,
        motion=motion,
        residual=residual,
        n_candidates=sum(own.n_candidates for own in found),
        fit=None,
        branches=tuple(zip(branches, found)),
    )


def tuned_apart(found, view_of):
    """Return a robot's effects with shapes that suit another recording."""
    # view_of: makes the `RecordingView` of a branch in that recording.
    known = {}
    for branch, own in found.branches:
        if own.effects:
            tuned = tuned_on(view_of(branch), own.effects, own.settings)
            for before, after in zip(own.effects, tuned):
                known.setdefault(branch.on_robot(before).key(), branch.on_robot(after))
    return tuple(known[effect.key()] for effect in found.effects)
