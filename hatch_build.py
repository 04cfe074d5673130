"""Metadata that depends on where the repository is: its URLs, and README with absolute links.

GESTICULATOR_URL is the address of the repository on its forge, such as https://example.org/group/gesticulator (the
workflow passes its own), else the one in pyproject.toml. Without one a distribution has no URLs and README as it is.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

VARIABLE = "GESTICULATOR_URL"
_LINK = re.compile(r"(!?\[[^\]]*\]\()(?![a-zA-Z][a-zA-Z0-9+.-]*:|#|/)([^)\s]+)(?=\))")
"""A link or a picture of Markdown: what stands before its relative address, and the address."""


def absolute(markdown: str, url: str) -> str:
    """Markdown whose relative links and pictures lead to files of the repository at `url`, at its default branch."""
    return _LINK.sub(lambda link: f"{link[1]}{url}/{'raw' if link[1].startswith('!') else 'blob'}/HEAD/{link[2]}",
                     markdown)


class RepositoryMetadata(MetadataHookInterface):
    """Sets `readme` and `urls` of the project."""

    def update(self, metadata: dict[str, Any]) -> None:
        """ValueError for an address that is not of the web."""
        url = (os.environ.get(VARIABLE) or self.config["repository"]).strip().rstrip("/")
        metadata["readme"] = "README.md"
        if "OWNER" in url:
            return
        if not re.fullmatch(r"https?://[^\s/]+/\S+", url):
            raise ValueError(f"{VARIABLE} is {url!r}: give the address of the repository, https://HOST/PATH")
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": absolute(text, url)}
        metadata["urls"] = {"Homepage": url, "Documentation": f"{url}/tree/HEAD/docs", "Source": url,
                            "Issues": f"{url}/issues", "Changelog": f"{url}/blob/HEAD/CHANGELOG.md"}
