"""Topic `app`: the page in headless Chromium, on 500 000 samples and a 20 x 20 map, and on 1 000 000 x 20 channels."""

import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import environment_of_users
from benchmarks.table import Table

SAMPLES = 500_000
STRIP_SAMPLES, STRIPS = 1_000_000, 20
REPEATS = 15
SENSOR = """
[model]
file = "sensor.kf"

[[dataset]]
files = ["drive.parquet"]

[[criterion]]
node = "Temperature"
target = { channel = "measured" }
"""
PROJECT = (
    SENSOR
    + """
[parameters.MapSettled]
x = { input = "Speed", begin = 700, end = 4200, count = 20 }
y = { input = "Load", begin = 5, end = 95, count = 20 }
initial = 300

[parameters.CurveTime]
x = { input = "Speed", begin = 700, end = 4200, count = 8 }
initial = 2
"""
)
FUNCTION = """
settled[degC] = MapSettled(Speed, Load)
Temperature[degC] = PT1(settled, CurveTime(Speed))
"""
STRIP_PROJECT = (
    SENSOR
    + """
[parameters.MapTemperature]
x = { input = "Speed", begin = 700, end = 4200, count = 20 }
y = { input = "Load", begin = 5, end = 95, count = 20 }
initial = 300
"""
)
STRIP_FUNCTION = "Temperature[degC] = MapTemperature(Speed, Load)"
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


# keeps a strip for each channel, as the list of signals does
CHOOSE = """
async names => {
  const project = document.querySelector('.project small').textContent.trim();
  const strips = names.map(name => ({ weight: 1, lines: [{ kind: 'channel', name }] }));
  localStorage.setItem('kennfeld.plots:' + project, JSON.stringify({ strips }));
}
"""
# resolves when the answers have come and a frame has passed
SETTLED = """
new Promise(resolve => {
  const begin = performance.now();
  const wait = () => document.documentElement.dataset.state === 'busy' ? setTimeout(wait, 0)
    : requestAnimationFrame(() => setTimeout(() => resolve(performance.now() - begin)));
  %s
  setTimeout(wait, 0);
})
"""
CLICK = "document.querySelector('[data-screen=plots]').click();"
OPEN = f"() => {SETTLED % CLICK}"
PRESS = f"key => {SETTLED % 'dispatchEvent(new KeyboardEvent(`keydown`, {key, bubbles: true}));'}"
WHEEL = """
  const canvas = document.querySelector('.strips canvas:last-of-type');
  const box = canvas.getBoundingClientRect();
  const place = {clientX: box.left + box.width / 2, clientY: box.top + 50};
  canvas.dispatchEvent(new WheelEvent('wheel', {...place, %s, bubbles: true, cancelable: true}));
"""
ZOOM = f"() => {SETTLED % (WHEEL % 'deltaY: -120')}"
PAN = f"() => {SETTLED % (WHEEL % 'deltaX: 40')}"


def run() -> list[Table]:
    """Time to a usable page, an edit, a move of a drag, a zoom; the same for many strips; memory of the server."""
    columns = ("step", "median", "worst")
    edits = Table("app: 500 000 samples, a 20 x 20 map, every edit recomputes the whole model", columns)
    strips = Table(f"app: {STRIPS} strips of 1 000 000 samples", columns)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        edits.add("page", "-", "missing: playwright")
        return [edits]
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        edits.add("page", "-", "missing: Chromium")
        return [edits]
    with sync_playwright() as driver:
        # browser first: it would start while the server reads the project
        for table, write, measure in ((edits, _write, _measure), (strips, _write_strips, _measure_strips)):
            own, page = _open(driver, browser)
            _serve(table, write, partial(measure, table, page))
            own.close()
    return [edits, strips]


def _serve(table: Table, write: Callable[[Path], int], measure: Callable[[str, float, int], None]) -> None:
    """Serve a project, call `measure(address, begin, process)`, and note the memory of the server."""
    with tempfile.TemporaryDirectory() as folder:
        size = write(Path(folder))
        begin = time.perf_counter()
        command = [sys.executable, "-c", LAUNCH]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder, env=environment_of_users())
        assert process.stdout is not None
        try:
            address = re.search(r"http\S+", process.stdout.readline())
            assert address is not None
            measure(address[0], begin, process.pid)
            table.notes = [
                *table.notes,
                f"{_memory(process.pid) / 1e6:.0f} MB in the server, {size / 1e6:.0f} MB of data. Load {load()}.",
            ]
        finally:
            process.kill()
            process.wait()
            process.stdout.close()


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


def _write_strips(folder: Path) -> int:
    """Write a recording with many channels; return the size of its data in memory, in bytes."""
    import pandas as pd

    rng = np.random.default_rng(2)
    time_s = np.arange(STRIP_SAMPLES) * 0.01
    columns = {"time": time_s, "Speed": 2400 + 1600 * np.sin(time_s / 37), "Load": 50 + 40 * np.sin(time_s / 11)}
    columns["measured"] = 100 + 0.1 * columns["Speed"] + 2 * columns["Load"] + rng.normal(0, 3, STRIP_SAMPLES)
    for number in range(STRIPS - 3):
        columns[f"Channel{number}"] = np.sin(time_s / (3 + 7 * number)) + rng.normal(0, 0.1, STRIP_SAMPLES)
    frame = pd.DataFrame(columns)
    frame.to_parquet(folder / "drive.parquet")
    (folder / "kennfeld.toml").write_text(STRIP_PROJECT, encoding="utf-8")
    (folder / "sensor.kf").write_text(STRIP_FUNCTION, encoding="utf-8")
    return int(frame.memory_usage(deep=True).sum())


def _measure(table: Table, page: Any, address: str, begin: float, process: int) -> None:
    received: list[int] = []
    page.on("response", lambda answer: received.append(int(answer.headers.get("content-length", "0"))))
    ready = "html[data-state=ready]"
    page.goto(address)
    page.wait_for_selector(ready)
    first = time.perf_counter() - begin
    table.notes = [f"The server took {_processor_time(process):.1f} s of processor time until the page was usable."]
    table.add("start of the program until the page is usable", f"{first * 1e3:.0f} ms", f"{sum(received) / 1e3:.0f} kB")
    _row(table, "page opened again, usable", lambda: _reopened(page, ready), 7)
    page.click("[data-parameter=MapSettled]")
    page.wait_for_selector(ready)
    numbers = iter(range(500, 100_000, 997))
    _row(table, "edit of a cell until everything is drawn", lambda: _edit(page, next(numbers)))
    _row(table, "small step of a point until everything is drawn", lambda: _step(page))
    page.click("[data-screen=plots]")
    page.wait_for_timeout(1500)
    _row(table, "zoom of five strips until they are drawn", lambda: _zoom(page))


def _open(driver: Any, browser: str) -> tuple[Any, Any]:
    own = driver.chromium.launch(executable_path=browser, args=["--headless", "--no-sandbox", "--disable-gpu"])
    return own, own.new_context(viewport={"width": 1280, "height": 800}).new_page()


def _measure_strips(table: Table, page: Any, address: str, _: float, __: int) -> None:
    page.goto(address)
    page.wait_for_selector("html[data-state=ready]")
    names = ["Speed", "Load", "measured", *(f"Channel{number}" for number in range(STRIPS - 3))]
    page.evaluate(CHOOSE, names)
    page.reload()
    page.wait_for_selector("html[data-state=ready]")
    begin = time.perf_counter()
    page.click("[data-screen=plots]")
    page.wait_for_selector("html[data-state=ready]")
    table.add("first drawing, all channels read from the file", f"{(time.perf_counter() - begin) * 1e3:.0f} ms", "")
    page.wait_for_timeout(1000)
    _row(table, "drawing, screen opened again", lambda: _reopened_plots(page), 7)
    _row(table, "zoom until all strips are drawn", lambda: _zoom(page))
    _row(table, "pan until all strips are drawn", lambda: float(page.evaluate(PAN)))
    _row(table, "step of the cursor until its values are shown", lambda: float(page.evaluate(PRESS, "ArrowRight")))
    for _ in range(30):
        _zoom(page)
    _row(table, "zoom of raw samples", lambda: _zoom(page))
    page.click("[data-screen=parameters]")
    page.click("[data-parameter=MapTemperature]")
    page.wait_for_selector("html[data-state=ready]")
    numbers = iter(range(500, 100_000, 997))
    _row(table, "edit of a cell until everything is drawn", lambda: _edit(page, next(numbers)))


def _reopened_plots(page: Any) -> float:
    page.click("[data-screen=optimization]")
    page.wait_for_selector("html[data-state=ready]")
    return float(page.evaluate(OPEN))


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
    return float(page.evaluate(ZOOM))


def _processor_time(process: int) -> float:
    """Return the processor time that a process has taken in s, 0 if it is unknown."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory(process: int) -> float:
    """Return the resident memory of a process in bytes, 0 if it is unknown."""
    try:
        status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    match = re.search(r"VmRSS:\s+(\d+) kB", status)
    return float(match[1]) * 1e3 if match else 0.0
