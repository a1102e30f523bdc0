"""Write what leads between the versions of the documentation in a folder.

``python .ci/docs_versions.py FOLDER ADDRESS``: the folder holds one for each version,
"dev" and tags such as "v0.2.0", and is published under the address. Written are
``switcher.json``, which the pages read, and ``index.html``, which leads to the newest
release.
"""

import json
import re
import sys
from pathlib import Path

_TAG = re.compile(r"v(\d+)\.(\d+)\.(\d+)((?:a|b|rc)\d+)?")


def released(name):
    """Return what versions are sorted by; None for a folder that is no release."""
    match = _TAG.fullmatch(name)
    if match is None:
        return None
    # A release comes after its candidates.
    return (*map(int, match.groups()[:3]), match[4] is None, match[4] or "")


def write_versions(site, address):
    """Write the list of versions, newest first, and the page that leads to one."""
    folders = [path.name for path in site.iterdir() if path.is_dir()]
    tags = sorted(filter(released, folders), key=released, reverse=True)
    final = [tag for tag in tags if released(tag)[3]]
    best = (final or tags or ["dev"])[0]
    entries = [
        {
            "name": f"{tag[1:]} (stable)" if tag == best else tag[1:],
            "version": tag,
            "url": f"{address}/{tag}/",
            "preferred": tag == best,
        }
        for tag in tags
    ]
    if "dev" in folders:
        entries.append({"name": "dev", "version": "dev", "url": f"{address}/dev/"})
    (site / "switcher.json").write_text(json.dumps(entries, indent=1) + "\n")
    (site / "index.html").write_text(
        "<!doctype html>\n"
        f'<meta http-equiv="refresh" content="0; url={best}/">\n'
        f'<title>sklearn_vbjfa</title>\n<a href="{best}/">Documentation</a>\n'
    )


if __name__ == "__main__":
    write_versions(Path(sys.argv[1]), sys.argv[2].rstrip("/"))
