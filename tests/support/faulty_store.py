"""Something between a client and an S3 server that does what bad days bring."""

import contextlib
import socket
import threading
import time
from urllib.parse import urlsplit


class FaultyStore:
    """Forwards requests to a store, except that some get one of the faults in `next_faults`.

    "500": that answer. "cut": the connection ends in the middle of the request. "short": it ends in the
    middle of the answer. "slow": the request is forwarded a second later. "": none.
    """

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._target = (str(parts.hostname), int(parts.port or 80))
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=64)
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.next_faults: list[str] = []
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Accept no more connections."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(5)

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with client:
            try:
                store = socket.create_connection(self._target)
            except OSError:
                return
            with store:
                back = threading.Thread(target=_pump, args=(store, client), daemon=True)
                back.start()
                with contextlib.suppress(OSError):
                    self._forward(client, store)
                for each in (client, store):
                    with contextlib.suppress(OSError):
                        each.shutdown(socket.SHUT_RDWR)
                back.join()

    def _forward(self, client: socket.socket, store: socket.socket) -> None:
        while data := client.recv(65536):
            fault = ""
            if data.startswith((b"PUT ", b"GET ")) and self.next_faults:
                fault = self.next_faults.pop(0)
            if fault == "500":
                client.sendall(b"HTTP/1.1 500 Internal Server Error\r\nContent-Length: 0\r\n\r\n")
                return
            if fault == "cut":
                store.sendall(data[: len(data) // 2])
                return
            if fault == "short":
                client.sendall(b"HTTP/1.1 200 OK\r\nContent-Len")
                return
            if fault == "slow":
                time.sleep(1.0)
            store.sendall(data)


def _pump(source: socket.socket, target: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(65536):
            target.sendall(data)
    with contextlib.suppress(OSError):
        target.shutdown(socket.SHUT_RDWR)
