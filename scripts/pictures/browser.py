"""Pages of the app and reports in Chromium, and pictures of them with a palette."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright
from scripts.pictures.drawing import IMAGES

READY = "html[data-state=ready]"
SIZE = {"width": 1280, "height": 800}
MOST_BYTES = 150_000


@contextmanager
def open_browser() -> Iterator[Any]:
    """Return a page that is closed at the end."""
    path = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser.new_page(viewport=SIZE)
        browser.close()


@contextmanager
def open_app(project: Path) -> Iterator[Any]:
    """Serve a project and return the page of the app."""
    command = [sys.executable, "-m", "kennfeld", "app", str(project), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = server.stdout.readline().split()[-1]
            with open_browser() as page:
                page.goto(address)
                page.wait_for_selector(READY)
                yield page
        finally:
            server.terminate()


def take(page: Any, name: str, **options: Any) -> None:
    """Write what the page shows as WebP with 256 colours, exact but for these: three quarters of the bytes of a PNG."""
    picture = Image.open(BytesIO(page.screenshot(**options))).convert("RGB")
    file = BytesIO()
    few = picture.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).convert("RGB")
    few.save(file, "WEBP", lossless=True, quality=100, method=6)
    size = file.tell()
    assert size <= MOST_BYTES, f"{name}.webp has {size} bytes, more than {MOST_BYTES}"
    (IMAGES / f"{name}.webp").write_bytes(file.getvalue())
    print(f"{name}.webp: {size / 1000:.0f} kB")
