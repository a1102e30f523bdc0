"""What was found, as text, Markdown, HTML and JSON."""

from sklearn_vbjfa import lazy_names

# For the command line and the tests; users get `sklearn_vbjfa.diagnosis.Report`.
__getattr__, __dir__ = lazy_names(
    __name__, {"contradiction": "_limits", "gain_doubts": "_gains"}
)
