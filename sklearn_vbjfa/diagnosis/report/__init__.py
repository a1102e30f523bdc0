"""What was found, as text, Markdown, HTML and JSON."""

from sklearn_vbjfa import lazy_names

# For the command line, the design of motions, the pages of effects and the tests; users
# get `sklearn_vbjfa.diagnosis.Report`.
_NAMES = {
    "_evidence": "about_effect added_torque documentation_of explanation source_of",
    "_limits": "contradiction gain_doubts",
    "_mathml": "mathml",
    "_pictures": "HEIGHT WIDTH effect_figure line_figure "
    "map_picture packed residual_picture ticks time_axis",
    "_render": "Section Table figure page plain_text style text_table",
    "_report": "sections",
    "_verdict": "judge",
}
__getattr__, __dir__ = lazy_names(
    __name__,
    {name: module for module, own in _NAMES.items() for name in own.split()},
    {"words": "_words"},
)
