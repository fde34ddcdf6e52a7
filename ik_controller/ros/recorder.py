"""Recorder: switches a run's recording on and off, without the loop waiting for a disk.

Bags are made and sealed beside the loop; it takes one up, or drops it, between two cycles.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from pathlib import Path
from typing import Any

from ik_controller.errors import BagError
from ik_controller.recording.rosbag2 import new_bag_folder
from ik_controller.recording.run import RunWriter
from ik_controller.recording.writer import WriterStatus
from ik_controller.session import Session


class Recorder:
    """The recording of one run; `bag` is what the loop writes to, None while it does not record."""

    def __init__(self, logger: Any) -> None:
        self.bag: RunWriter | None = None
        self.failure = ""  # why the last start was none
        self._logger = logger
        self._wanted: RunWriter | None = None
        self._changes: deque[RunWriter | None] = deque()
        self._sealing: list[threading.Thread] = []

    # -- the executor's side

    @property
    def folder(self) -> Path | None:
        """The bag that is being written, or None."""
        return None if self._wanted is None else self._wanted.folder

    def start(self, session: Session, topics: dict[str, str], folder: str, name: str) -> Path:
        """Make a bag `name`_DATE_NUMBER in `folder` and hand it to the loop; return its folder. Raises BagError, and
        leaves nothing behind then.
        """
        try:
            made = new_bag_folder(Path(folder).expanduser(), name)
            try:
                bag = RunWriter(made, session, topics)
            except BagError:
                with contextlib.suppress(OSError):
                    made.rmdir()
                raise
        except BagError as error:
            self.failure = str(error)
            raise
        self.failure = ""
        self._wanted = bag
        self._changes.append(bag)
        self._logger.info(f"recording to {bag.folder}")
        return bag.folder

    def stop(self) -> None:
        """End the recording; the bag is sealed."""
        self.failure = ""
        self._wanted = None
        self._changes.append(None)

    def close(self) -> None:
        """Seal what is open, after the loop; return when all is on disk."""
        self._seal(self.bag)
        for bag in self._changes:  # made, but the loop ended before it took it up
            self._seal(bag)
        self._changes.clear()
        self.bag = self._wanted = None
        for thread in self._sealing:
            thread.join()

    # -- the loop's side

    def switch(self, session: Session, now: int) -> RunWriter | None:
        """Take up or drop bags as asked for; return what to write to."""
        while self._changes:
            dropped, self.bag = self.bag, self._changes.popleft()
            if dropped is not None:
                thread = threading.Thread(target=self._seal, args=(dropped,), name="seal")
                self._sealing = [*(t for t in self._sealing if t.is_alive()), thread]
                thread.start()
            if self.bag is not None:
                self.bag.begin(session, now)
        return self.bag

    def status(self) -> WriterStatus | None:
        """Return how the recording goes, None while there is none."""
        return None if self.bag is None else self.bag.writer.status()

    def _seal(self, bag: RunWriter | None) -> None:
        if bag is None:
            return
        status = bag.close()
        lost = f", {status.lost} lost" if status.lost else ""
        self._logger.info(f"recorded {status.messages} messages to {bag.folder}{lost}")
