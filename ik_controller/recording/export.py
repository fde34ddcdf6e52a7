"""Export: every cycle's signals as CSV or Parquet, for a notebook, written while the replay runs."""

from __future__ import annotations

import csv
import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_controller.errors import IkControllerError
from ik_controller.recording.signals import Signals

Array = NDArray[np.float64]


class CsvSink:
    """Writes rows to a CSV file: a header line, numbers that read back bit for bit, empty where there is no value."""

    def __init__(self, path: Path) -> None:
        """Raises IkControllerError where the file cannot be written."""
        try:
            self._file = path.open("w", newline="", encoding="utf-8")
        except OSError as error:
            raise IkControllerError(f"--csv {path}: {error.strerror}") from None
        self._writer = csv.writer(self._file, lineterminator="\n")

    def begin(self, signals: Signals) -> None:
        """Write the header."""
        self._writer.writerow([*signals.names, "state"])

    def take(self, rows: Array, states: Sequence[str]) -> None:
        """Write rows."""
        for row, state in zip(rows.tolist(), states, strict=True):
            self._writer.writerow([*("" if value != value else value for value in row), state])

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class ParquetSink:
    """Writes rows to a Parquet file, a row group a block; needs pyarrow."""

    def __init__(self, path: Path) -> None:
        """Raises IkControllerError where pyarrow is missing."""
        try:
            self._arrow: Any = importlib.import_module("pyarrow")
            self._parquet: Any = importlib.import_module("pyarrow.parquet")
        except ImportError:
            raise IkControllerError(
                "--parquet needs pyarrow: pip install 'ik_controller[parquet]'; --csv needs nothing"
            ) from None
        self._path = path
        self._writer: Any = None

    def begin(self, signals: Signals) -> None:
        """Open the file with the columns' names. Raises IkControllerError where it cannot be written."""
        arrow = self._arrow
        fields = [arrow.field(name, arrow.float64()) for name in signals.names]
        self._schema = arrow.schema([*fields, arrow.field("state", arrow.dictionary(arrow.int32(), arrow.string()))])
        try:
            self._writer = self._parquet.ParquetWriter(self._path, self._schema)
        except OSError as error:
            raise IkControllerError(f"--parquet {self._path}: {error.strerror or error}") from None

    def take(self, rows: Array, states: Sequence[str]) -> None:
        """Write rows; NaN becomes null."""
        arrow = self._arrow
        columns = [arrow.array(column, from_pandas=True) for column in np.ascontiguousarray(rows.T)]
        columns.append(arrow.array(states).dictionary_encode())
        self._writer.write_table(arrow.table(columns, schema=self._schema))

    def close(self) -> None:
        """Close the file."""
        if self._writer is not None:
            self._writer.close()
