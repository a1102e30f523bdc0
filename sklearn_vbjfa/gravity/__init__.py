"""Gravity compensation: correct a description from poses and slow motion."""

from typing import TYPE_CHECKING

from sklearn_vbjfa import _lazily

# What type checkers see of names that are imported when they are asked for.
if TYPE_CHECKING:
    from sklearn_vbjfa.gravity._correction import GravityCorrection, correct_gravity
    from sklearn_vbjfa.gravity._poses import gravity_poses
    from sklearn_vbjfa.gravity._samples import static_samples

__all__ = ["GravityCorrection", "correct_gravity", "gravity_poses"]
_MODULES = {
    "_correction": ("GravityCorrection", "correct_gravity"),
    "_poses": ("gravity_poses",),
    "_samples": ("static_samples",),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
