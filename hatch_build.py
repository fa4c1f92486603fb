"""What a package index shows, told by the place that builds the package."""

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface


class CustomMetadataHook(MetadataHookInterface):
    """The README, and the addresses of the project where SIGMAX_REPOSITORY names that of its repository.

    An index has no files beside the README: its links lead into the repository then.
    """

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill in `readme` and `urls`."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        home = os.environ.get("SIGMAX_REPOSITORY", "").rstrip("/")
        metadata["urls"] = {}
        if home:
            text = re.sub(r"\]\((?![a-z]+:|#)([^)]+)\)", rf"]({home}/blob/main/\1)", text)
            pages = {"Documentation": "docs/index.md", "Changelog": "CHANGELOG.md"}
            metadata["urls"] = {"Source": home, "Issues": f"{home}/issues"}
            metadata["urls"] |= {name: f"{home}/blob/main/{page}" for name, page in pages.items()}
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
