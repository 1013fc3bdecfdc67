"""Painting beside the window: a thread that always works on the newest wish.

A new view is first painted with a rough outline, and in full when nothing new was asked for a while; a view
that is known is painted in full at once. What is at rest is always full quality.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass

from lambent_relight import RelightError

from lambent.desktop.painter import Painted, Painter, SupersededError
from lambent.desktop.state import ViewerState

REST_S = 0.15
"""How long nothing must change before a new view's outline is worked out."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Frame:
    """A state and its pixels; without pixels, `problem` says why."""

    state: ViewerState
    painted: Painted | None
    problem: str = ""


class RenderLoop:
    """Owns the thread that uses a painter."""

    def __init__(self, painter: Painter, *, rest_s: float = REST_S) -> None:
        """Start; `close` ends it."""
        self._painter, self._rest_s = painter, rest_s
        self._changed = threading.Condition()
        self._wanted: ViewerState | None = None
        self._jobs: list[Callable[[], None]] = []
        self._frame: Frame | None = None
        self._working = False
        self._closed = False
        self._in_job = False
        self._failure: BaseException | None = None
        painter.is_superseded = self._is_superseded
        self._thread = threading.Thread(target=self._run, name="lambent-painter", daemon=True)
        self._thread.start()

    def ask(self, state: ViewerState) -> None:
        """Wish for the picture of `state`; an older wish is forgotten."""
        with self._changed:
            self._wanted = state
            self._changed.notify_all()

    def run_with_painter(self, job: Callable[[], None]) -> None:
        """Run `job` on the painter's thread, after what is being painted; it may use the painter."""
        with self._changed:
            self._jobs.append(job)
            self._changed.notify_all()

    def take(self) -> Frame | None:
        """Return the newest frame that was not taken yet, or None; raises what ended the thread."""
        with self._changed:
            if self._failure is not None:
                raise self._failure
            frame, self._frame = self._frame, None
            return frame

    def wait_until_idle(self, timeout_s: float) -> bool:
        """Return whether everything asked for was done within the time."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._wanted is None and not self._working and not self._jobs, timeout_s
            )

    def close(self) -> None:
        """End the thread when its jobs are done; a picture on its way is given up."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    def _is_superseded(self) -> bool:
        with self._changed:
            return not self._in_job and (self._closed or self._wanted is not None)

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as failure:  # the window's thread raises it
            with self._changed:
                self._failure, self._working = failure, False
                self._wanted, self._jobs = None, []
                self._changed.notify_all()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._working = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._closed or self._wanted is not None or self._jobs)
                if self._closed and not self._jobs:
                    return
                state, self._wanted = self._wanted, None
                jobs, self._jobs = self._jobs, []
                self._working = True
            if state is not None and not self._closed:
                self._paint(state)
            self._in_job = True
            for job in jobs:
                job()
            self._in_job = False

    def _paint(self, state: ViewerState) -> None:
        try:
            if not self._painter.knows_view(state):
                self._show(state, self._painter.paint(state, full=False))
                with self._changed:
                    self._changed.wait_for(
                        lambda: self._closed or self._wanted is not None or bool(self._jobs), self._rest_s
                    )
                    if self._closed or self._wanted is not None:
                        return
            self._show(state, self._painter.paint(state, full=True))
        except SupersededError:
            return
        except RelightError as error:
            with self._changed:
                self._frame = Frame(state=state, painted=None, problem=str(error))

    def _show(self, state: ViewerState, painted: Painted) -> None:
        with self._changed:
            self._frame = Frame(state=state, painted=painted)
