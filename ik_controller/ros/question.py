"""Question: a request to a service that is asked again until it is answered."""

from __future__ import annotations

import time
from typing import Any

_AGAIN = 1.0  # [s]


class Question:
    """A request without effect, to be polled. An answer is lost while the server has not discovered the client yet."""

    def __init__(self, client: Any, request: Any) -> None:
        self._client, self._request = client, request
        self._future: Any = None
        self._asked = 0.0

    def answer(self) -> Any:
        """Return the response once it is there, None until then; asks, and asks again after a second."""
        if self._future is not None and self._future.done():
            return self._future.result()
        now = time.monotonic()
        if self._client.service_is_ready() and (self._future is None or now > self._asked + _AGAIN):
            if self._future is not None:
                self._client.remove_pending_request(self._future)
            self._future, self._asked = self._client.call_async(self._request), now
        return None
