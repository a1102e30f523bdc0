"""Make the links of the README absolute, for PyPI.

Run as ``.ci/release_links.py https://github.com/OWNER/NAME v0.2.0`` by Python in the
checkout that is built: links to documentation lead to the published pages of that
version, other links to its files, and pyproject.toml gets ``[project.urls]``. The
results are not committed, because the address is known at the release only.
"""

import re
import sys
from pathlib import Path


def main():
    """Rewrite both files of the folder that it is run in."""
    address, version = sys.argv[1].rstrip("/"), sys.argv[2]
    readme, project = Path("README.md"), Path("pyproject.toml")
    owner, name = address.split("/")[-2:]
    pages = f"https://{owner}.github.io/{name}/{version}"
    text = readme.read_text(encoding="utf-8")
    text = re.sub(
        r"\]\(docs/([\w-]+)\.(?:rst|md|html)\)", rf"]({pages}/\g<1>.html)", text
    )
    # Pictures are shown, files are opened as pages.
    for begin, kind in ((r"!\[[^]]*\]\(", "raw"), (r"(?<!!)\[[^]]*\]\(", "blob")):
        text = re.sub(
            rf"({begin})(?!\w+:|#)", rf"\g<1>{address}/{kind}/{version}/", text
        )
    readme.write_text(text, encoding="utf-8")
    text = project.read_text(encoding="utf-8")
    if "[project.urls]" in text:
        raise SystemExit("pyproject.toml has [project.urls] already")
    urls = {
        "Source": address,
        "Documentation": pages,
        "Changelog": f"{address}/blob/{version}/CHANGELOG.md",
        "Issues": f"{address}/issues",
    }
    lines = [f'{name} = "{url}"' for name, url in urls.items()]
    table = "\n".join(["[project.urls]", *lines])
    text = text.replace("[project.scripts]", f"{table}\n\n[project.scripts]", 1)
    project.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
