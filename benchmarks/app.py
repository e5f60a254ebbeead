"""Topic `app`: the page in headless Chromium, on 500 000 samples and a 20 x 20 map."""

import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.table import Table

SAMPLES = 500_000
REPEATS = 15
PROJECT = """
[model]
file = "sensor.kf"

[[dataset]]
files = ["drive.parquet"]

[[criterion]]
node = "Temperature"
target = { channel = "measured" }

[parameters.MapSettled]
x = { input = "Speed", begin = 700, end = 4200, count = 20 }
y = { input = "Load", begin = 5, end = 95, count = 20 }
initial = 300

[parameters.CurveTime]
x = { input = "Speed", begin = 700, end = 4200, count = 8 }
initial = 2
"""
FUNCTION = """
settled[degC] = MapSettled(Speed, Load)
Temperature[degC] = PT1(settled, CurveTime(Speed))
"""
LAUNCH = (
    "from pathlib import Path; from kennfeld.app.launch import launch; launch(Path('kennfeld.toml'), browser=False)"
)
# resolves to the time until all answers to an edit have come and a frame has passed
DRAWN = """
key => new Promise(resolve => {
  const page = document.documentElement;
  const begin = performance.now();
  let drawn = NaN;
  const observer = new MutationObserver(() => {
    if (page.dataset.state === 'ready') requestAnimationFrame(() => setTimeout(() => { drawn = performance.now(); }));
  });
  observer.observe(page, { attributeFilter: ['data-state'] });
  document.querySelector('table.grid').dispatchEvent(new KeyboardEvent('keydown', {key, bubbles: true}));
  setTimeout(() => { observer.disconnect(); resolve(drawn - begin); }, 500);
})
"""


def run() -> list[Table]:
    """Time to a usable page, an edit, a move of a drag, a zoom; memory of the server."""
    table = Table(
        "app: 500 000 samples, a 20 x 20 map, every edit recomputes the whole model", ("step", "median", "worst")
    )
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        table.add("page", "-", "missing: playwright")
        return [table]
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        table.add("page", "-", "missing: Chromium")
        return [table]
    with tempfile.TemporaryDirectory() as folder:
        size = _write(Path(folder))
        process = subprocess.Popen([sys.executable, "-c", LAUNCH], stdout=subprocess.PIPE, text=True, cwd=folder)
        assert process.stdout is not None
        try:
            found = re.search(r"http\S+", process.stdout.readline())
            assert found is not None
            with sync_playwright() as driver:
                _measure(table, driver, browser, found[0])
            table.notes = [
                f"{_memory(process.pid) / 1e6:.0f} MB in the server, {size / 1e6:.0f} MB of data. Load {load()}."
            ]
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
    return [table]


def _write(folder: Path) -> int:
    """Write the project; return the size of its data in memory, in bytes."""
    import pandas as pd

    rng = np.random.default_rng(1)
    time_s = np.arange(SAMPLES) * 0.1
    speed = np.clip(2400 + 1600 * np.sin(time_s / 37) + rng.normal(0, 20, SAMPLES), 700, 4200)
    load_share = 50 + 40 * np.sin(time_s / 11)
    measured = 100 + 0.1 * speed + 2 * load_share + rng.normal(0, 3, SAMPLES)
    frame = pd.DataFrame({"time": time_s, "Speed": speed, "Load": load_share, "measured": measured})
    frame.to_parquet(folder / "drive.parquet")
    (folder / "kennfeld.toml").write_text(PROJECT, encoding="utf-8")
    (folder / "sensor.kf").write_text(FUNCTION, encoding="utf-8")
    return int(frame.memory_usage(deep=True).sum())


def _measure(table: Table, driver: Any, browser: str, address: str) -> None:
    own = driver.chromium.launch(executable_path=browser, args=["--headless", "--no-sandbox", "--disable-gpu"])
    page = own.new_context(viewport={"width": 1280, "height": 800}).new_page()
    received: list[int] = []
    page.on("response", lambda answer: received.append(int(answer.headers.get("content-length", "0"))))
    ready = "html[data-state=ready]"
    begin = time.perf_counter()
    page.goto(address)
    page.wait_for_selector(ready)
    first = time.perf_counter() - begin
    table.add("first page usable", f"{first * 1e3:.0f} ms", f"{sum(received) / 1e3:.0f} kB")
    _row(table, "page opened again, usable", lambda: _reopened(page, ready), 7)
    page.click("[data-parameter=MapSettled]")
    page.wait_for_selector(ready)
    numbers = iter(range(500, 100_000, 997))
    _row(table, "edit of a cell until everything is drawn", lambda: _edit(page, next(numbers)))
    _row(table, "small step of a point until everything is drawn", lambda: _step(page))
    page.click("[data-screen=plots]")
    page.wait_for_timeout(1500)
    _row(table, "zoom of five strips until they are drawn", lambda: _zoom(page))
    own.close()


def _row(table: Table, name: str, measure: Callable[[], float], repeats: int = REPEATS) -> None:
    times = [measure() for _ in range(repeats)]
    table.add(name, f"{statistics.median(times):.0f} ms", f"{max(times):.0f} ms")


def _reopened(page: Any, ready: str) -> float:
    begin = time.perf_counter()
    page.reload()
    page.wait_for_selector(ready)
    return (time.perf_counter() - begin) * 1e3


def _edit(page: Any, number: int) -> float:
    page.click("[data-cell='10,10']")  # a cell with samples, so that the error changes
    page.keyboard.type(str(number))
    return float(page.evaluate(DRAWN, "Enter"))


def _step(page: Any) -> float:
    """Raise a value by a small step, as a move of a dragged point does."""
    return float(page.evaluate(DRAWN, "+"))


def _zoom(page: Any) -> float:
    """Turn the wheel; the strips are drawn when the answer has come and a frame has passed."""
    script = """
    () => new Promise(resolve => {
      const canvas = document.querySelector('.strips canvas');
      const box = canvas.getBoundingClientRect();
      const begin = performance.now();
      const place = {clientX: box.left + box.width / 2, clientY: box.top + 50};
      canvas.dispatchEvent(new WheelEvent('wheel', {...place, deltaY: -120, bubbles: true, cancelable: true}));
      const wait = () => document.documentElement.dataset.state === 'busy' ? setTimeout(wait, 0)
        : requestAnimationFrame(() => setTimeout(() => resolve(performance.now() - begin)));
      setTimeout(wait, 0);
    })
    """
    return float(page.evaluate(script))


def _memory(process: int) -> float:
    """Return the resident memory of a process in bytes, 0 where it cannot be told."""
    try:
        status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    match = re.search(r"VmRSS:\s+(\d+) kB", status)
    return float(match[1]) * 1e3 if match else 0.0
