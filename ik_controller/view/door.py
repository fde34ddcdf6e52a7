"""Door: the gate in front of the page's server.

viser has no access control, so it listens on a loopback port of its own, and browsers come through the door. It reads
the first request of each connection and passes the connection on as it is if it may enter: on this machine's loopback,
a page of our own (another site's page in the same browser must not steer an arm); from a network, who brings the token
(`?token=…`, from then on a cookie).
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import secrets
import threading
from urllib.parse import parse_qs, urlsplit

LOOPBACK = ("localhost", "127.0.0.1", "::1")

_COOKIE = "ik_controller_token"
_ASK = (
    "<!doctype html><meta name=viewport content='width=device-width'><title>ik_controller</title>"
    "<body style='font:16px system-ui;display:grid;place-items:center;height:90vh'><form>"
    "<p>This arm's page asks for its token: it stands in the terminal that runs <code>ik_controller view</code>.</p>"
    "<input name=token autofocus autocomplete=off> <button>Enter</button></form>"
)


class Door:
    """Serves `host`:`port` in a thread and passes on to the loopback port `inner`.

    `token` opens it from a network; empty where `host` is the loopback: then none is needed. `address`: the URL to
    open.
    """

    def __init__(self, host: str, port: int, inner: int) -> None:
        """Raises OSError where the address cannot be listened on."""
        self.token = "" if host in LOOPBACK else secrets.token_urlsafe(12)
        self._inner = inner
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="door", daemon=True)
        self._thread.start()
        listening = asyncio.run_coroutine_threadsafe(asyncio.start_server(self._enter, host, port), self._loop)
        try:
            self._server = listening.result(10.0)
        except OSError:
            self._loop.call_soon_threadsafe(self._loop.stop)
            raise
        self.port: int = self._server.sockets[0].getsockname()[1]
        self.address = f"http://{host}:{self.port}" + (f"/?token={self.token}" if self.token else "")

    def close(self) -> None:
        """Stop listening."""
        self._loop.call_soon_threadsafe(self._server.close)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(2.0)

    async def _enter(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        wrong = (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, asyncio.TimeoutError, ValueError)
        with contextlib.suppress(*wrong):
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 10.0)
            request, _, rest = head.decode("latin-1").partition("\r\n")
            headers = {
                name.strip().lower(): value.strip() for name, _, value in (x.partition(":") for x in rest.split("\r\n"))
            }
            asked = parse_qs(urlsplit(request.split(" ")[1]).query).get("token", [""])[0]
            if self.token and self._fits(asked):
                cookie = f"{_COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict"
                writer.write(_answer("303 See Other", f"Location: /\r\nSet-Cookie: {cookie}\r\n"))
            elif self._may_enter(headers):
                await self._pass_on(head, reader, writer)
            elif self.token:
                writer.write(_answer("401 Unauthorized", "Content-Type: text/html; charset=utf-8\r\n", _ASK))
            else:
                writer.write(_answer("403 Forbidden", "", "this page is for browsers on its own machine"))
            await writer.drain()
        writer.close()

    def _may_enter(self, headers: dict[str, str]) -> bool:
        if self.token:
            pairs = (pair.strip().partition("=") for pair in headers.get("cookie", "").split(";"))
            return any(name == _COOKIE and self._fits(value) for name, _, value in pairs)
        host, origin = headers.get("host", ""), headers.get("origin", "")
        return urlsplit(f"//{host}").hostname in LOOPBACK and origin in ("", f"http://{host}")

    def _fits(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self.token.encode())

    async def _pass_on(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inner_reader, inner_writer = await asyncio.open_connection("127.0.0.1", self._inner)
        inner_writer.write(head)
        await asyncio.gather(_pump(reader, inner_writer), _pump(inner_reader, writer))


def _answer(status: str, headers: str, body: str = "") -> bytes:
    return f"HTTP/1.1 {status}\r\n{headers}Content-Length: {len(body)}\r\nConnection: close\r\n\r\n{body}".encode()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
    with contextlib.suppress(OSError):
        writer.close()
