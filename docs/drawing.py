"""What the scripts pictures*.py share: the folder of their pictures, and making those that are named."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

IMAGES = Path(__file__).parent / "images"


def make(*pictures: Callable[[], Any]) -> None:
    """Save the figure that each function returns as its name; those named on the command line, or all."""
    IMAGES.mkdir(exist_ok=True)
    functions = {function.__name__: function for function in pictures}
    for name in sys.argv[1:] or functions:
        figure = functions[name]()
        # Without the date and version a picture is the same file when made again.
        figure.savefig(IMAGES / f"{name}.png", dpi=110, metadata={"Software": None})
        plt.close(figure)
        print(IMAGES / f"{name}.png")
