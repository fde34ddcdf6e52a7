"""The door in front of the live page: who may enter."""

from __future__ import annotations

import http.client
import http.server
import threading
from collections.abc import Iterator

import pytest

pytest.importorskip("viser")

from ik_controller.view.door import Door


@pytest.fixture
def inner() -> Iterator[int]:
    """A server on the loopback that says "inside" to everybody."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", "6")
            self.end_headers()
            self.wfile.write(b"inside")

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.server_address[1]
    server.shutdown()
    server.server_close()


def ask(port: int, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20.0)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    response = connection.getresponse()
    response.body = response.read()  # type: ignore[attr-defined]
    connection.close()
    return response


def test_on_the_loopback_no_token_is_needed(inner):
    door = Door("127.0.0.1", 0, inner)
    try:
        assert door.address == f"http://127.0.0.1:{door.port}"
        assert ask(door.port).body == b"inside"
        own = f"http://127.0.0.1:{door.port}"
        assert ask(door.port, Origin=own).body == b"inside"
    finally:
        door.close()


def test_on_the_loopback_other_sites_stay_out(inner):
    door = Door("127.0.0.1", 0, inner)
    try:
        assert ask(door.port, Origin="http://evil.example").status == 403  # a page that would steer the arm
        assert ask(door.port, Host="evil.example").status == 403  # a name that was pointed here
    finally:
        door.close()


def test_from_a_network_the_token_opens(inner):
    door = Door("0.0.0.0", 0, inner)
    try:
        refused = ask(door.port)
        assert refused.status == 401
        assert b"token" in refused.body
        assert ask(door.port, "/?token=wrong").status == 401
        assert ask(door.port, Cookie="ik_controller_token=wrong").status == 401
        entered = ask(door.port, f"/?token={door.token}")
        assert entered.status == 303
        cookie = entered.getheader("Set-Cookie").split(";")[0]
        assert door.token in cookie
        assert ask(door.port, Cookie=f"other=1; {cookie}").body == b"inside"
        assert door.address.endswith(f"?token={door.token}")
    finally:
        door.close()


def test_a_request_that_is_none_is_dropped(inner):
    import socket

    door = Door("127.0.0.1", 0, inner)
    try:
        with socket.create_connection(("127.0.0.1", door.port), timeout=20.0) as connection:
            connection.sendall(b"\x00\x01nonsense\r\n\r\n")
            assert b"200" not in connection.recv(1000)
        assert ask(door.port).body == b"inside"
    finally:
        door.close()
