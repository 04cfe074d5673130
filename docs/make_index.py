"""Write the table of pages in index.md from the navigation in mkdocs.yml: `python docs/make_index.py`.

Every page that people wrote is listed under its part of the navigation with its first sentence. The tables under
results/ and report/ are made by commands; results.md links to them.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parent.parent
HEADING = "## Pages\n"
MADE = ("results/", "report/")


def summary(page: Path) -> str:
    """The first sentence of a page, without its links."""
    paragraph = page.read_text(encoding="utf-8").split("\n\n")[1]
    sentence = re.match(r"(.+?\.)(?:\s|$)", " ".join(paragraph.split()))
    if not sentence or paragraph.startswith(("```", "|", "    ")):
        raise SystemExit(f"{page}: a page begins with a sentence that says what it is about")
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", sentence.group(1))


def parts(nav: list[dict[str, Any]]) -> list[tuple[str, list[tuple[str, str]]]]:
    """Each part of the navigation with the titles and files of its pages; single pages and inner parts are left out."""
    listed = [(title, [(name, file) for entry in pages for name, file in entry.items()
                       if isinstance(file, str) and not file.startswith(MADE)])
              for part in nav for title, pages in part.items() if isinstance(pages, list)]
    return [(title, pages) for title, pages in listed if pages]


def index(root: Path) -> str:
    """index.md with its list of pages made anew."""
    before = (root / "docs" / "index.md").read_text(encoding="utf-8").partition(HEADING)[0]
    nav = yaml.safe_load((root / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    text = before + HEADING
    for title, pages in parts(nav):
        text += f"\n### {title}\n\n| page | content |\n|---|---|\n"
        text += "".join(f"| [{name}]({file}) | {summary(root / 'docs' / file)} |\n" for name, file in pages)
    return text


if __name__ == "__main__":
    (ROOT / "docs" / "index.md").write_text(index(ROOT), encoding="utf-8")
