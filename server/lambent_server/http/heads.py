"""HEAD wherever there is GET: the same answer without its body (RFC 9110, 9.3.2)."""

from lambent_server.http.request import App, Message, Receive, Scope, Send

HEAD = "head"
"""In the state of a request that is answered like a GET, but without a body."""


class _Enough(Exception):  # noqa: N818 (it ends a response, and is not a mistake)
    """The headers are sent, and nothing more is wanted."""


class HeadAsGet:
    """ASGI middleware around the routes, which know GET only."""

    def __init__(self, app: App) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        complete = False

        async def send_head(message: Message) -> None:
            nonlocal complete
            if message["type"] != "http.response.body":
                await send(message)
                return
            if not complete:
                await send({"type": "http.response.body", "body": b""})
                complete = True
            if message.get("more_body", False):
                # A stream may have no end, and a file would be read for nobody.
                raise _Enough

        scope.setdefault("state", {})[HEAD] = True
        scope["method"] = "GET"
        try:
            await self._app(scope, receive, send_head)
        except Exception as error:
            if not _is_enough(error):
                raise
        finally:
            # For what counts and logs the request.
            scope["method"] = "HEAD"


def _is_enough(error: BaseException) -> bool:
    if isinstance(error, BaseExceptionGroup):
        return all(map(_is_enough, error.exceptions))
    return isinstance(error, _Enough)
