"""The interface for external segmenters: `module:callable`, or a name registered by a package.

A registered segmenter may take an option: `name=option` calls its method `configured` with it.
"""

from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import entry_points
from typing import Protocol

from lambent_core.errors import UsageError

from lambent_capture.arrays import Grey
from lambent_capture.masks.consensus import MaskView

ENTRY_POINTS = "lambent.segmenters"


class Segmenter(Protocol):
    """Finds the object in the pictures of one capture."""

    def __call__(self, views: Sequence[MaskView]) -> Sequence[Grey]:
        """Return for each view how much of each pixel the object covers, 0..1, at the size of its picture.

        All views show the same object; their cameras are known. Raise `WorkerError` where it is not found.
        """


def find_segmenter(name: str) -> Segmenter:
    """Return the segmenter `module:callable`, or the one that an installed package offers under this name.

    A package offers one as an entry point of the group `lambent.segmenters` that is a `Segmenter`;
    `name=option` is for those with a method `configured(option)`, which returns a `Segmenter`. Raises
    `UsageError` where it is not found or takes no option. What is named is imported and run: never take a
    name from a capture.
    """
    offered_name, equals, option = name.partition("=")
    module, colon, attribute = name.partition(":")
    if colon and not equals:
        return _imported(name, module, attribute)
    registered = entry_points(group=ENTRY_POINTS)
    if offered_name not in registered.names:
        offered = ", ".join(sorted(registered.names)) or "none"
        raise UsageError(
            "config.segmenter_unknown",
            f'--segmenter "{name}" is offered by no installed package (there are: {offered}); install the '
            "package, give module:callable, or leave the option out for the built-in estimate",
        )
    segmenter: Segmenter = registered[offered_name].load()
    if not equals:
        return segmenter
    configured = getattr(segmenter, "configured", None)
    if configured is None:
        raise UsageError(
            "config.segmenter_unknown",
            f'--segmenter "{offered_name}" takes no option; leave out "={option}"',
        )
    chosen: Segmenter = configured(option)
    return chosen


def _imported(name: str, module: str, attribute: str) -> Segmenter:
    try:
        segment = getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise UsageError(
            "config.segmenter_unknown",
            f'--segmenter "{name}" cannot be imported ({error}); give module:callable, with the module on '
            "PYTHONPATH",
        ) from error
    if not callable(segment):
        raise UsageError(
            "config.segmenter_unknown",
            f'--segmenter "{name}" is not a function; give one that takes the views',
        )
    segmenter: Segmenter = segment
    return segmenter
