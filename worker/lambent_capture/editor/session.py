"""From the command to the page and back: one person corrects the masks of one run."""

import webbrowser
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import lambent_pages
from lambent_core.errors import UsageError
from lambent_pages.loopback import can_open_pages, ending_like_ctrl_c, serving

from lambent_capture.editor.requests import PAGE, Desk, DeskHandler
from lambent_capture.masks.corrections import Correction
from lambent_capture.masks.editing import Editing


def correct_masks(
    editing: Editing,
    corrections: Sequence[Correction],
    keep: Callable[[Sequence[Correction]], None],
    *,
    command: str,
    tell: Callable[[str], None],
    opens: bool = True,
    open_page: Callable[[str], Any] = webbrowser.open,
    pages: Path = lambent_pages.FOLDER,
) -> bool:
    """Serve the page until the person is done; return whether they said so, False for Ctrl-C.

    `keep` is called with all corrections after every change, from another thread; `tell` with the address.
    The page is opened where there is a screen, if `opens`. Raises `UsageError`
    (`run.pages_not_built`) where this copy of Lambent has no pages, and what `Editing.apply` raises.
    """
    if lambent_pages.find(PAGE, pages) is None:
        raise UsageError(
            "run.pages_not_built",
            "this copy of Lambent was installed from its sources, without the web pages; run `make pages` in "
            "the checkout (needs Node 20)",
        )
    tell("drawing the outlines ...")
    editing.apply(corrections)
    desk = Desk(editing=editing, corrections=corrections, keep=keep, command=command, pages=pages)
    with (
        ending_like_ctrl_c(),
        suppress(KeyboardInterrupt),
        serving(lambda *given: DeskHandler(*given, desk=desk)) as origin,
    ):
        url = f"{origin}{desk.address()}"
        tell(f"correct the masks at {url}")
        tell("press Done there when they are right; Ctrl-C ends it too, and keeps what was corrected")
        if opens and can_open_pages():
            open_page(url)
        desk.done.wait()
    return desk.done.is_set()
