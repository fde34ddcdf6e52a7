"""Make the picture of the report page for docs/: `python docs/pictures_report.py`. Needs chromium and playwright."""

from __future__ import annotations

import io
import shutil
import tempfile
from pathlib import Path

from PIL import Image

from ik_controller.recording.timeline import collect
from ik_controller.report.page import write_page
from ik_controller.share import bag_folder

IMAGES = Path(__file__).parent / "images"


def report() -> bytes:
    """Return the top of the golden run's report, as a PNG of few colours."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        file = Path(folder) / "report.html"
        write_page(collect(bag_folder("panda_golden")), file)
        flags = ["--no-sandbox", "--disable-gpu"]
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        page = browser.new_page(viewport={"width": 1360, "height": 900})
        page.goto(file.as_uri())
        page.evaluate("page.show(Math.floor(0.28 * run.rows))")
        shot = page.screenshot()
        browser.close()
    picture = Image.open(io.BytesIO(shot)).convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE)
    out = io.BytesIO()
    picture.save(out, "PNG", optimize=True)
    return out.getvalue()


if __name__ == "__main__":
    if shutil.which("chromium"):
        (IMAGES / "report.png").write_bytes(report())
        print(IMAGES / "report.png")
    else:
        print("no chromium: docs/images/report.png stays as it is")
