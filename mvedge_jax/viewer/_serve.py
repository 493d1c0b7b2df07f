"""A server of one page, for this machine alone unless told otherwise."""

import contextlib
import errno
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

# Ports tried after one that is in use.
_TRIES = 20
_LOCAL = {"127.0.0.1", "localhost", "::1"}


class Server(ThreadingHTTPServer):
    """Serves one page; `serve_forever` does, `shutdown` from another thread ends it.

    Attributes:
        html: the page.
        url: where it is.
    """

    daemon_threads = True
    # Otherwise a second server on the port that is in use would be let in on some systems.
    allow_reuse_address = sys.platform != "win32"

    def __init__(self, html: str, host: str, port: int):
        self.html = html.encode("utf-8")
        super().__init__((host, port), _Handler)
        self.url = f"http://{host}:{self.server_address[1]}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Says nothing of a browser that was closed while it was loading."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: Server  # pyright: ignore[reportIncompatibleVariableOverride]
    timeout = 30

    def do_GET(self) -> None:  # noqa: D102
        self._answer(body=True)

    def do_HEAD(self) -> None:  # noqa: D102
        self._answer(body=False)

    def _answer(self, *, body: bool) -> None:
        host = self.headers.get("Host", "").rsplit(":", 1)[0].strip("[]")
        # A name that another site has led here must not read the page.
        if str(self.server.server_address[0]) in _LOCAL and host not in _LOCAL:
            self.send_error(403)
        elif self.path.split("?")[0] != "/":
            self.send_error(404)
        else:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(self.server.html)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            if body:
                with contextlib.suppress(ConnectionError):
                    self.wfile.write(self.server.html)

    def log_message(self, format: str, *args: Any) -> None:
        """Keeps the terminal for messages to the user."""


def serve(html: str, *, host: str = "127.0.0.1", port: int = 8765) -> Server:
    """Opens a port for a page.

    Args:
        html: the page.
        host: the address to listen at: this machine alone by default.
        port: the first port to try; 0 for any.

    Returns:
        A server that listens; its `serve_forever` answers.

    Raises:
        OSError: the port, and the 20 after it, are in use; or the address is not this machine's.
        ValueError: there is no such port.
    """
    if not 0 <= port <= 65535:
        raise ValueError(f"the port must be between 0 and 65535, got {port}.")
    last = port if port == 0 else min(port + _TRIES, 65535)
    for candidate in range(port, last + 1):
        try:
            return Server(html, host, candidate)
        except OSError as reason:
            if reason.errno == errno.EADDRINUSE:
                continue
            raise OSError(
                f"the page cannot be served at {host}, port {candidate}: {reason.strerror}."
            ) from None
    raise OSError(f"the ports {port} to {last} are in use; choose another, or 0 for any.")
