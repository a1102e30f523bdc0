r"""Formulas for a page that has to work without a network: LaTeX as MathML.

What an effect's `formula` needs of LaTeX and no more: letters and numbers, scripts,
fractions, roots, dots, fences, names and spaces. Browsers draw MathML by themselves,
where a library for LaTeX would be a megabyte in every page.
"""

import re
from html import escape

_TOKEN = re.compile(
    r"\\[A-Za-z]+|\\[^A-Za-z]|[A-Za-z]|[0-9]+(?:\.[0-9]+)?|\s+|.", re.DOTALL
)
_GREEK = dict(
    zip(
        "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi "
        "rho sigma tau upsilon phi chi psi omega".split(),
        "αβγδεζηθικλμνξπρστυφχψω",
    )
) | dict(
    zip(
        "Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega".split(),
        "ΓΔΘΛΞΠΣΥΦΨΩ",
    )
)
_NAMED = ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "max", "min")
_SIGNS = {
    "partial": "∂",
    "cdot": "·",
    "times": "×",
    "pm": "±",
    "le": "≤",
    "leq": "≤",
    "ge": "≥",
    "geq": "≥",
    "ne": "≠",
    "approx": "≈",
    "infty": "∞",
    "int": "∫",
    "sum": "∑",
    "ldots": "…",
    "in": "∈",
    "to": "→",
}
_SPACES = {
    "\\,": "0.17em",
    "\\:": "0.22em",
    "\\;": "0.28em",
    "\\ ": "0.33em",
    "\\quad": "1em",
    "\\qquad": "2em",
}
_ACCENTS = {"dot": "˙", "ddot": "¨", "bar": "¯", "hat": "^", "tilde": "~"}
_UPRIGHT = ("mathrm", "operatorname")
_FENCES = {".": "", "\\{": "{", "\\}": "}", "\\|": "‖"}


def mathml(formula):
    """Convert LaTeX, as between dollar signs; ValueError for what is not known here."""
    # One ``math`` element for each of the parts between wide spaces (\quad), where a
    # line may break.
    parts = re.split(r"\\q?quad(?![A-Za-z])", formula)
    converted = [_Reader(part).all() for part in parts if part.strip()]
    return " ".join(f"<math>{one}</math>" for one in converted)


class _Reader:
    """Tokens of a formula, read once from left to right."""

    def __init__(self, text):
        self._tokens = _TOKEN.findall(text)
        self._at = 0

    def all(self):
        """Convert everything."""
        out = self._row(end=None)
        if self._at < len(self._tokens):
            raise ValueError(f"{self._tokens[self._at]!r} has no beginning.")
        return out

    def _peek(self):
        """Next token that is not a space; empty at the end."""
        while self._at < len(self._tokens) and self._tokens[self._at].isspace():
            self._at += 1
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _next(self):
        token = self._peek()
        self._at += 1
        return token

    def _row(self, end):
        """Convert up to a closing token, which stays; None is the end."""
        out = []
        while (token := self._peek()) and token not in ("}", "\\right"):
            out.append(self._scripted())
        if (token or None) != end:
            raise ValueError(f"expected {end or 'the end'}, got {token or 'the end'}.")
        return "".join(out)

    def _scripted(self):
        """Convert one thing with what stands below and above it."""
        base, scripts = self._atom(), {}
        while self._peek() in ("_", "^") and self._peek() not in scripts:
            mark = self._next()
            scripts[mark] = self._atom()
        if not scripts:
            return base
        tag = {"_": "msub", "^": "msup"}[next(iter(scripts))]
        if len(scripts) == 2:
            tag = "msubsup"
        ordered = "".join(scripts[mark] for mark in "_^" if mark in scripts)
        return f"<{tag}>{base}{ordered}</{tag}>"

    def _atom(self):
        """Convert one thing."""
        token = self._next()
        if token == "{":
            return self._closed("}")
        if token in _SPACES:
            return f'<mspace width="{_SPACES[token]}"/>'
        if token.startswith("\\"):
            return self._command(token[1:])
        if token.isalpha():
            return f"<mi>{token}</mi>"
        if token[:1].isdigit():
            return f"<mn>{token}</mn>"
        if token in ("", "}", "_", "^", "&", "$", "#", "%", "~"):
            raise ValueError(f"{token or 'the end'!r} where a symbol was expected.")
        return _operator({"-": "−", "*": "∗", "'": "′"}.get(token, token))

    def _closed(self, end):
        """Convert a group up to its closing token, which is read."""
        inside = self._row(end)
        self._next()
        return f"<mrow>{inside}</mrow>"

    def _command(self, name):
        if name in _GREEK:
            # Capital Greek is upright in LaTeX.
            way = ' mathvariant="normal"' if name[0].isupper() else ""
            return f"<mi{way}>{_GREEK[name]}</mi>"
        if name in _NAMED:
            thin = _SPACES["\\,"]
            after = "0" if self._peek() in ("(", "\\left") else thin
            return f'<mo lspace="{thin}" rspace="{after}">{name}</mo>'
        if name in _SIGNS:
            sign = _SIGNS[name]
            if name in ("partial", "infty"):
                return f"<mi>{sign}</mi>"
            return f"<mo>{sign}</mo>"
        if name in _ACCENTS:
            return (
                f'<mover accent="true">{self._atom()}<mo>{_ACCENTS[name]}</mo></mover>'
            )
        if name == "frac":
            return f"<mfrac>{self._atom()}{self._atom()}</mfrac>"
        if name == "sqrt":
            return f"<msqrt>{self._atom()}</msqrt>"
        if name in _UPRIGHT:
            return f'<mi mathvariant="normal">{self._words()}</mi>'
        if name == "text":
            return f"<mtext>{self._words()}</mtext>"
        if name == "left":
            return self._fenced()
        raise ValueError(f"\\{name} is not known here.")

    def _words(self):
        """Read a group as it is."""
        if self._next() != "{":
            raise ValueError("a name has no braces.")
        words = []
        while (token := "".join(self._tokens[self._at : self._at + 1])) != "}":
            if not token:
                raise ValueError("a name has no end.")
            words.append(token.removeprefix("\\"))
            self._at += 1
        self._at += 1
        # A space at the end of an element would be lost.
        return escape("".join(words)).replace(" ", "\u00a0")

    def _fenced(self):
        opening = self._next()
        inside = self._row("\\right")
        self._next()
        closing = self._next()
        fences = [_FENCES.get(sign, sign) for sign in (opening, closing)]
        first, last = (
            f'<mo fence="true" form="{form}">{escape(sign)}</mo>' if sign else ""
            for form, sign in zip(("prefix", "postfix"), fences)
        )
        return f"<mrow>{first}{inside}{last}</mrow>"


def _operator(sign):
    """Write a sign; a bar has no side that tells how far it stands off."""
    if sign == "|":
        return '<mo stretchy="false" lspace="0" rspace="0">|</mo>'
    if sign in "()[]":
        return f'<mo stretchy="false">{sign}</mo>'
    if sign == "/":
        return '<mo lspace="0" rspace="0">/</mo>'
    return f"<mo>{escape(sign)}</mo>"
