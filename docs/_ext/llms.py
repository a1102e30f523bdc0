"""``llms.txt`` in the root of the pages: a list of pages for language models.

The form is that of https://llmstxt.org: a title, what the package is, and links with
the first sentence of each page.
"""

import re
from pathlib import Path

from docutils import nodes

import sklearn_vbjfa

# Headings, and the pages below each by the beginnings of their names.
_SECTIONS = (
    ("Guide", ""),
    ("Effects", "effects/"),
    ("Examples", "auto_examples/"),
    ("API", "generated/"),
)
_LONGEST = 200  # characters of a sentence


def first_sentence(doctree):
    """Return the first sentence of a page; empty for a page without a paragraph."""
    for paragraph in doctree.findall(nodes.paragraph):
        # Not in tables, notes and buttons.
        if isinstance(paragraph.parent, (nodes.section, nodes.document)):
            text = " ".join(paragraph.astext().split())
            sentence = re.split(r"(?<=[a-z0-9)][.:]) (?=[A-Z`])", text)[0]
            return (
                sentence if len(sentence) <= _LONGEST else f"{sentence[:_LONGEST]}..."
            )
    return ""


def section_of(name):
    """Return the heading below which a page is listed."""
    for heading, begin in reversed(_SECTIONS):
        if name.startswith(begin):
            return heading
    raise ValueError(f"{name!r} is in no section.")


def listing(env, address):
    """Return the text of the file; ``address(name)`` is that of a page."""
    lines = [f"# {env.config.project} {env.config.release}", ""]
    lines += [f"> {sklearn_vbjfa.__doc__.splitlines()[0]}", ""]
    pages = {heading: [] for heading, _ in _SECTIONS}
    for name in sorted(env.found_docs):
        title = env.titles[name].astext()
        said = first_sentence(env.get_doctree(name))
        pages[section_of(name)].append(
            f"- [{title}]({address(name)})" + (f": {said}" if said else "")
        )
    for heading, entries in pages.items():
        if entries:
            lines += [f"## {heading}", "", *entries, ""]
    return "\n".join(lines)


def _write(app, error):
    """Write the file to the built pages."""
    if error is None and app.builder.name == "html":
        text = listing(app.env, app.builder.get_target_uri)
        (Path(app.outdir) / "llms.txt").write_text(text, encoding="utf-8")


def setup(app):
    """Write the file at the end of a build."""
    app.connect("build-finished", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
