"""A robot of many joints searched branch by branch, and what was found put together.

The branches that leave a fixed base share no body: neither the torques of one nor their
parameters depend on the others, so that a search on all of them together finds what
searches on each find, at a cost that rises with the cube of all joints rather than with
their number.
"""

from dataclasses import dataclass, replace

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.diagnosis.search._model import SearchModel
from sklearn_vbjfa.diagnosis.search._search import Found
from sklearn_vbjfa.model._loading import import_pinocchio

# A robot of up to this many joints is searched as a whole, in which an effect may join
# two branches, such as a coupling through a common drive: so are arms, and most hands.
_TOGETHER = 7
# Parameters of an identifier that may have a value for each joint.
_BY_JOINT = ("state_cutoff", "joint_weights", "torque_noise")
# Fields of a recording that have a column for each joint.
_COLUMNS = ("q", "tau", "v", "weight", "torque_noise")


@dataclass(frozen=True, kw_only=True, eq=False)
class Branch:
    """A branch of a robot as a robot of its own.

    Attributes
    ----------
    joints : list of int
        Its joints among those of the robot, rising.
    model : pinocchio.Model
        The branch alone.
    """

    joints: list
    model: object

    def identifier(self, declared):
        """Return the declared model of the branch, not fitted, in the robot's band."""
        asked = declared.get_params(deep=False)
        own = {name: self._own(asked[name]) for name in _BY_JOINT}
        cutoff = declared.cutoff_
        return clone(declared).set_params(
            model=self.model,
            cutoff=float(cutoff) if np.isfinite(cutoff) else None,
            standstill=declared.standstill_[self.joints],
            **own,
        )

    def _own(self, value):
        """Return a parameter's values for the branch's joints."""
        return np.asarray(value)[self.joints] if np.ndim(value) == 1 else value

    def recording(self, recording):
        """Return the columns of a recording that belong to the branch."""
        given = {name: getattr(recording, name) for name in _COLUMNS}
        columns = {
            name: value[..., self.joints]
            for name, value in given.items()
            if value is not None
        }
        if recording.states is not None:
            states = recording.states.reshape(recording.n_samples, 3, -1)
            columns["states"] = states[:, :, self.joints].reshape(len(states), -1)
        for name in ("joint_names", "position_units", "torque_units"):
            whole = getattr(recording, name)
            columns[name] = tuple(whole[j] for j in self.joints)
        return replace(recording, **columns)

    def local(self, joints):
        """Numbers in the branch of those of some joints that belong to it."""
        return [k for k, j in enumerate(self.joints) if j in joints]

    def on_robot(self, effect):
        """Return an effect of the branch as one of the robot; None stays None."""
        if effect is None:
            return None
        if effect.scope == "robot":
            return effect
        shape = effect.get_params(deep=False)
        moved = {name: self.joints[shape[name]] for name in ("joint", *effect.partners)}
        return clone(effect).set_params(**moved)


def root_joints(model):
    """First joint of the branch of each joint of a robot, ndarray of shape (nv,)."""
    return np.array([model.supports[j][1] - 1 for j in range(1, model.njoints)])


def branches_of(robot, library, max_effects):
    """Return the branches to search one by one, list of Branch; one is the whole.

    Of a fitted declared model. A limit on the number of effects, an effect on a joint
    that is declared already, and one's own effects, of which nobody knows which joints
    they look at, ask for the whole robot.
    """
    model = robot.features_.model_
    root = root_joints(model)
    roots = np.unique(root)
    own = [type(effect).__module__.split(".")[0] for effect in library]
    if (
        model.nv <= _TOGETHER
        or roots.size == 1
        or max_effects is not None
        or robot.effects_
        or set(own) != {__name__.split(".")[0]}
    ):
        return [Branch(joints=list(range(model.nv)), model=model)]
    found = []
    for first in roots:
        joints = [int(k) for k in np.flatnonzero(root == first)]
        found.append(Branch(joints=joints, model=_alone(model, joints)))
    return found


def _alone(model, joints):
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


def put_together(view, library, branches, found, alpha):
    """Put what was `Found` on the branches of a robot together.

    Parameters
    ----------
    view : RecordingView
        The recording of the whole robot, with the declared model.
    library : tuple of Effect
        Effects that were searched.
    branches : list of Branch
        Branches that were searched.
    found : list of Found
        What was found on each, with its share of the level of significance.
    alpha : float
        Level of significance of the whole robot.

    Returns
    -------
    Found
        Steps in the order of the branches, effects numbered by the robot's joints.
    """
    effects, evidence, steps = [], [], []
    squares = SearchModel.of(view).squares.sum(axis=0)
    for branch, own in zip(branches, found):
        for effect, case in zip(map(branch.on_robot, own.effects), own.evidence):
            # What belongs to the whole robot several branches may have found.
            if effect.key() not in {one.key() for one in effects}:
                effects.append(effect)
                evidence.append(case)
        for step in own.steps:
            steps.append(_step_on_robot(step, branch, squares))
        squares = _with_own(squares, branch, own.model.squares.sum(axis=0))
    return Found(
        model=SearchModel.of(view, effects, SearchModel.of(view)),
        evidence=tuple(evidence),
        steps=tuple(steps),
        threshold=min((own.threshold for own in found), default=alpha),
        n_tests=sum(own.n_tests for own in found),
        library=library,
        branches=tuple(zip(branches, found)),
    )


def _step_on_robot(step, branch, squares):
    """Return a step on a branch as one on the robot, where the rest has squares."""
    candidates = {
        name: tuple(
            replace(one, effect=branch.on_robot(one.effect))
            for one in getattr(step, name)
        )
        for name in ("rivals", "tried")
    }
    return replace(
        step,
        effect=branch.on_robot(step.effect),
        replaced=branch.on_robot(step.replaced),
        squares_before=_with_own(squares, branch, step.squares_before),
        squares_after=_with_own(squares, branch, step.squares_after),
        **candidates,
    )


def _with_own(squares, branch, own):
    """Put sums of squares of a branch into those (nv,) of the robot."""
    squares = squares.copy()
    squares[branch.joints] = own
    return squares
