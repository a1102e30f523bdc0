"""Search for effects that are missing from the declared model."""

from sklearn_vbjfa import _lazily

# Names for `explain` and for tests.
_MODULES = {
    "_cosines": ("Cosines", "Spectrum"),
    "_held_out": ("HeldOut", "CrossValidatedGain", "fold_of"),
    "_posterior": ("SMALL", "UNDECIDED", "Evidence", "search"),
    "_problem": ("Columns", "Fit", "SelectedEffect", "Problem", "spectrum_of"),
    "_view": ("RecordingView",),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
