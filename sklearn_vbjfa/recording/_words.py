"""Words in names of columns and files, and the kinds of channels that they mean."""

import difflib
import re

from sklearn_vbjfa.recording._units import split_unit

_WORDS = {
    "t": "t ts time timestamp stamp clock",
    "q": "q pos position angle theta encoder",
    "v": "v dq qd qdot vel velocity velocities speed",
    "a": "ddq qdd qddot acc accel acceleration",
    "torque": "tau torque trq effort eff moment force load",
    "current": "current curr cur amp ampere i",
    "command": "target cmd command desired des ref reference goal setpoint sp action",
    "other": "error temperature temp voltage external ext limit cartesian tcp enable "
    "mode window model friction fric gravity grav control con feedforward ff",
}
_KIND_OF = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_MEASURED = {"measured", "meas", "actual", "act"}
# The least similarity of a word to one of these, and the shortest word that has any.
_SIMILAR, _LONG = 0.85, 4


def kinds_in(name):
    """Return the kinds that the words of a name mean, also misspelled, a set of str."""
    kinds = set()
    for word in _words(name):
        near = [x for x in (word, word.removesuffix("s")) if x in _KIND_OF][:1]
        if not near and len(word) >= _LONG:
            near = difflib.get_close_matches(word, _KIND_OF, 1, _SIMILAR)
        kinds |= {_KIND_OF[x] for x in near}
    return kinds


def is_measured(name):
    """Return whether a name says that it is a measurement."""
    return bool(_MEASURED & set(_words(name)))


def is_current(name):
    """Return whether a name says that it is a motor's current, and no torque."""
    kinds = kinds_in(name)
    return "current" in kinds and "torque" not in kinds


def _words(name):
    """Return the words in a name or pattern, in small letters."""
    text = re.sub(r"\{\w+\}", " ", split_unit(name)[0])
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [x.lower() for x in re.findall(r"[^\W\d_]+", text)]
