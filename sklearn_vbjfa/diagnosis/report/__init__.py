"""What was found, as text, HTML and JSON."""

from sklearn_vbjfa import _lazily
from sklearn_vbjfa.diagnosis.report import _words as words

# For the command line, the design of motions, the pages of effects and the tests, like
# `words`; users get `sklearn_vbjfa.diagnosis.Report`.
_MODULES = {
    "_figures": (
        "about_effect",
        "added_torque",
        "documentation_of",
        "explanation",
        "source_of",
    ),
    "_pictures": (
        "HEIGHT",
        "WIDTH",
        "effect_figure",
        "ticks",
    ),
    "_render": (
        "environment",
        "figure",
        "mathml",
        "style",
    ),
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
