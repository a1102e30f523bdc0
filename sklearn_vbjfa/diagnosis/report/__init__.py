"""Report of a search for effects, as text, HTML and JSON."""

from sklearn_vbjfa import _lazily
from sklearn_vbjfa.diagnosis.report import _words as words

# For the command line, the design of motions, the effect pages and tests, like `words`;
# users get `sklearn_vbjfa.diagnosis.Report`.
_MODULES = {
    "_facts": "SECONDS",
    "_pictures": "HEIGHT WIDTH ticks",
    "_render": "environment",
}
__getattr__, __dir__ = _lazily(__name__, _MODULES)
