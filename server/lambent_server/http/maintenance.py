"""The layer that answers writes with 503 during maintenance; reads and runs continue."""

import re

from anyio import to_thread

from lambent_server.api.problems import Problem
from lambent_server.cluster.server_state import MAINTENANCE, Notices
from lambent_server.http.request import SAFE, App, Receive, Scope, Send

# POSTs that change nothing but who is logged in, or nothing at all.
_READS = re.compile(r"/v1/(login|logout|login-links|estimates|me:switch)")


class Maintenance:
    """ASGI middleware around the routes, inside of the gate."""

    def __init__(self, app: App, notices: Notices) -> None:
        self._app = app
        self._notices = notices

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or refuse it."""
        writes = scope["type"] == "http" and scope["method"] not in SAFE
        if writes and _READS.fullmatch(scope["path"]) is None:
            known = self._notices.known()
            if known is None:
                known = await to_thread.run_sync(self._notices.now)
            notice = known.get(MAINTENANCE)
            if notice is not None:
                raise Problem(
                    503,
                    "maintenance",
                    notice.message or "the server is under maintenance and accepts no changes; reading works",
                    retryable=True,
                    headers={"retry-after": str(notice.retry_after_s)},
                )
        await self._app(scope, receive, send)
