"""The search for effects that the declared model lacks."""

from sklearn_vbjfa import _lazily

# For what follows from a search, and for tests.
_MODULES = {
    "_cosines": ("Cosines", "Spectrum"),
    "_held_out": ("HeldOut", "CrossValidatedGain", "fold_of"),
    "_posterior": ("SMALL", "UNDECIDED", "Evidence", "search"),
    "_problem": ("Columns", "Fit", "SelectedEffect", "Problem", "spectrum_of"),
    "_view": ("RecordingView",),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
