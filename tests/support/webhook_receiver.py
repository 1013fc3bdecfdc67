"""A receiver of webhooks on this machine that answers as a test says."""

import contextlib
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


@dataclass
class Receiver:
    """What came, and what the next answers are: a status, or a word for what a bad receiver does."""

    port: int = 0
    scheme: str = "http"
    answers: list[Any] = field(default_factory=list)
    got: list[tuple[dict[str, str], bytes]] = field(default_factory=list)
    at_once: int = 0
    most_at_once: int = 0
    slow_s: float = 0.0
    lock: Any = field(default_factory=threading.Lock)

    @property
    def url(self) -> str:
        """Where it listens."""
        return f"{self.scheme}://127.0.0.1:{self.port}/hook?token=x"

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of a server that may send here, and soon again."""
        return {
            "webhook_allowed": ("127.0.0.1/32",),
            "webhook_allow_http": True,
            "webhook_ports": (self.port,),
            "webhook_poll_s": 0.02,
            "webhook_retry_s": 0.05,
            "webhook_timeout_s": 1.0,
        }

    @property
    def ids(self) -> list[str]:
        """The ids of what came, in order."""
        return [headers["webhook-id"] for headers, _ in self.got]


def _handler(receiver: Receiver) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            with receiver.lock:
                headers = {name.lower(): value for name, value in self.headers.items()}
                receiver.got.append((headers | {":path": self.path}, body))
                answer = receiver.answers.pop(0) if receiver.answers else 204
                receiver.at_once += 1
                receiver.most_at_once = max(receiver.most_at_once, receiver.at_once)
            time.sleep(receiver.slow_s)
            with receiver.lock:
                receiver.at_once -= 1
            with contextlib.suppress(OSError):
                self._answer(answer)
            self.close_connection = True

        def _answer(self, answer: Any) -> None:
            if answer == "hang":
                time.sleep(2.5)
            elif answer == "drip":
                # Never silent for long, and never done.
                for letter in b"HTTP/1.1 200 OK\r\nx-slow: " + b"a" * 60:
                    self.wfile.write(bytes([letter]))
                    time.sleep(0.1)
            elif answer == "flood":
                self.wfile.write(b"HTTP/1.1 200 OK\r\ncontent-length: 1000000000000\r\n\r\n")
                for _ in range(200):
                    self.wfile.write(bytes(1 << 20))
            elif answer == "close":
                self.connection.shutdown(socket.SHUT_RDWR)
            else:
                self.send_response(answer)
                if 300 <= answer < 400:
                    self.send_header("location", f"http://127.0.0.1:{receiver.port}/elsewhere")
                self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    return Handler


@contextlib.contextmanager
def receiving(tls: ssl.SSLContext | None = None) -> Iterator[Receiver]:
    """Yield a receiver on a free port of the loopback address."""
    receiver = Receiver()
    server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(receiver))
    server.daemon_threads = True
    if tls is not None:
        server.socket = tls.wrap_socket(server.socket, server_side=True)
        receiver.scheme = "https"
    receiver.port = server.server_address[1]
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield receiver
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
