"""Build hook that refuses wheels without the web pages, because users may not have Node to build them."""

import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PAGES = Path("client/python/lambent_pages/dist")
REQUIRED = ("jobs.html", "viewer.html", "masks.html")
ANYWAY = "LAMBENT_WITHOUT_PAGES"


class RequirePages(BuildHookInterface):
    """Checks for the pages before a wheel is written; an editable installation does not need them."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Raise RuntimeError for a wheel whose pages were not built, unless that is explicitly allowed."""
        missing = [name for name in REQUIRED if not (Path(self.root) / PAGES / name).is_file()]
        if version == "standard" and missing and not os.environ.get(ANYWAY):
            raise RuntimeError(
                f"the web pages are not built ({', '.join(missing)} missing in {PAGES}): run `make pages` "
                f"(needs Node 20), or set {ANYWAY}=1 for a wheel whose server explains their absence"
            )
