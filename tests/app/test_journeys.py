"""Long journeys in a headless browser: from files to a released calibration, and what happens during a run."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kennfeld as kf
from tests.app.browser import READY, browser_page, started
from tests.app.shared_app import project_page

pytestmark = pytest.mark.slow

TORQUE = """\
trqOpt = MapOptTorque(Speed,Rel_Airmass)
ignOpt = MapOptIgnition(Speed,Rel_Airmass)
deltaSpark = ignOpt - Ignition
etaSpark = CurveEtaDeltaSpark(deltaSpark)
product = trqOpt * etaSpark
dragTorque = MapDragTorque(Speed,Rel_Airmass)
TorquePredict = product - dragTorque"""
EXAMPLE = Path(__file__).parents[2] / "examples" / "simulink"
CHANNELS = {"Speed": "n_mot", "Load": "rl", "Ignition": "zw", "Vehicle": "v_fzg", "T_sensor": "t_abg"}
WAIT = 240_000  # ms for a run on a busy machine

FLEET = """\
[model]
file = "sensor.kf"

[[dataset]]
name = "drives"
files = ["drive_*.csv"]

[parameters.MapTorque]
x = { input = "Speed", begin = 1000, end = 4000, count = 5 }
y = { input = "Load", begin = 0, end = 100, count = 5 }
initial = 0

[[criterion]]
node = "torque"
target = { channel = "Torque" }
"""


def export_dcm(page: Any) -> None:
    page.click("[data-screen=results]")
    page.wait_for_selector(READY)
    if page.locator("[data-format=dcm][aria-pressed=true]").count() == 0:
        page.click("[data-format=dcm]")
    page.click("#export-files")
    page.wait_for_selector("text=parameters.dcm")


def rmse(page: Any) -> float:
    return float(page.inner_text("#rmse-training").split()[0].replace("\u2212", "-"))


def test_from_a_csv_to_a_dcm_with_the_torque_model(torque: Path, tmp_path: Path) -> None:
    recording = next(path for path in sorted(torque.parent.glob("*.csv")) if "bench" in path.name)
    home = tmp_path / "home"
    home.mkdir()
    with started(None, home) as (address, process), browser_page(address) as page:
        page.fill("[aria-label='Name of the new project']", "torque")
        page.click("text=Create")
        page.set_input_files("input[type=file]", str(recording))
        page.wait_for_selector("[data-file='bench.csv']")
        page.click("[data-screen=function]")
        page.click(".cm-content")
        page.keyboard.insert_text(TORQUE)
        page.wait_for_selector("#proposals:has-text('MapDragTorque')")
        page.click("#add-all")
        page.wait_for_selector("#proposals", state="detached")
        page.wait_for_selector("#rmse-training b, #rmse-training:has-text('.')")
        before = rmse(page)
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=WAIT)
        assert rmse(page) < 0.1 * before
        page.click("#save")
        page.wait_for_selector("#unsaved:not(.dirty)")
        export_dcm(page)
        process.terminate()
        process.wait()
    folder = home / "torque"
    released = kf.read_parameters(folder / "results" / "parameters.dcm")
    project = kf.Project.read(folder / "kennfeld.toml")
    assert not [finding for finding in project.check() if finding.severity == "error"]
    assert {"MapOptTorque", "MapOptIgnition", "CurveEtaDeltaSpark", "MapDragTorque"} <= set(released)
    assert released["MapOptTorque"].values == pytest.approx(
        project.problem().parameters["MapOptTorque"].values, rel=1e-3, abs=1e-3
    )


def test_twenty_recordings_are_cross_validated_and_released_as_dcm(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    for number in range(20):
        speed, load = rng.uniform(1000, 4000, 200), rng.uniform(0, 100, 200)
        values = 0.05 * speed + 1.5 * load + rng.standard_normal(200)
        rows = "\n".join(f"{a:.1f},{b:.2f},{c:.3f}" for a, b, c in zip(speed, load, values, strict=True))
        (tmp_path / f"drive_{number:02}.csv").write_text(f"Speed,Load,Torque\n{rows}\n", encoding="utf-8")
    (tmp_path / "sensor.kf").write_text("torque[Nm] = MapTorque(Speed, Load)\n", encoding="utf-8")
    (tmp_path / "kennfeld.toml").write_text(FLEET, encoding="utf-8")
    with project_page(tmp_path / "kennfeld.toml", "data") as page:
        page.wait_for_selector(".heads:has-text('20 files')")
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=WAIT)
        assert 0.8 < rmse(page) < 1.1
        page.click("[data-screen=optimization]")
        page.wait_for_selector(READY)
        page.click("button:has-text('cross-validation')")
        page.wait_for_selector(READY)
        page.click("#cross-validate")
        page.wait_for_selector("#job-state.validated", timeout=WAIT)
        page.click("[data-screen=results]")
        held_out = page.wait_for_selector("[data-set=cross-validation] td.num:nth-child(3)").inner_text()
        assert 0.8 < float(held_out) < 1.3
        export_dcm(page)
        page.click("#save")
        page.wait_for_selector("#unsaved:not(.dirty)")
    released = kf.read_parameters(tmp_path / "results" / "parameters.dcm")["MapTorque"]
    assert float(released(2500.0, 50.0)) == pytest.approx(0.05 * 2500 + 1.5 * 50, abs=0.5)


@pytest.mark.guests
def test_from_a_dropped_simulink_model_to_the_values_of_its_map(tmp_path: Path) -> None:
    files = [str(EXAMPLE / name) for name in ("exhaust.mdl", "exhaust.m", "drive_1.csv", "drive_2.csv")]
    with started(None, tmp_path) as (address, process), browser_page(address) as page:
        page.set_input_files("#drop input", files)
        page.wait_for_selector("[data-file='drive_2.csv']")
        page.click("[data-screen=function]")
        page.click("[data-blocking='Sensor/Radiation'] .btn")
        page.fill("#binding", "0.15 * (t_wand - 20)")
        page.click(".binding button:text-is('Bind')")
        page.wait_for_selector("[data-blocking]", state="detached")
        page.click("#add-proposals")  # leads to where they are listed, as only the user knows the channels
        for name, channel in CHANNELS.items():
            page.select_option(f"#proposals select[aria-label^='{name} ']", channel)
        page.click("#add-all")
        page.wait_for_selector("#rmse-training:has-text('.')")
        before = rmse(page)
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=WAIT)
        assert rmse(page) < 0.1 * before
        page.click("[data-screen=parameters]")
        page.click("[data-parameter=MapGas]")
        page.wait_for_selector("td[data-cell='4,3']")
        shown = float(page.inner_text("td[data-cell='2,1']"))
        page.click("#save")
        page.wait_for_selector("#unsaved:not(.dirty)")
        export_dcm(page)
        process.terminate()
        process.wait()
    released = kf.read_parameters(tmp_path / "exhaust" / "results" / "parameters.dcm")["MapGas"]
    assert [axis.breakpoints.size for axis in released.axes] == [5, 4]
    assert released.values[2, 1] == pytest.approx(shown, abs=0.5)


def test_an_edit_during_a_run_waits_and_is_applied_to_its_values(torque: Path) -> None:
    with project_page(torque, "parameters") as page:
        page.click("[data-parameter=CurveEtaDeltaSpark]")
        page.wait_for_selector(READY)
        page.click("#run")
        page.wait_for_selector("#job-state.running")
        page.click("td[data-cell='1,0']")
        page.keyboard.type("0.123")
        page.keyboard.press("Enter")
        page.wait_for_selector("text=1 edit waits")
        page.wait_for_selector("#job-state.converged", timeout=WAIT)
        page.wait_for_selector(READY)
        assert float(page.inner_text("td[data-cell='1,0']")) == pytest.approx(0.123)
        assert page.locator("#undo").is_enabled()


def test_a_file_that_is_deleted_during_a_run_is_named_at_its_end(torque: Path) -> None:
    with project_page(torque, "optimization") as page:
        page.click("#run")
        page.wait_for_selector("#job-state.running")
        recording = next(path for path in sorted(torque.parent.glob("*.csv")) if "bench" in path.name)
        shutil.move(recording, torque.parent / "moved.away")
        page.wait_for_selector("#job-state:not(.running)", timeout=WAIT)
        page.wait_for_selector("text=bench.csv")
        page.click("#run")  # nothing runs on files that have changed unseen
        page.wait_for_selector("footer .bad:has-text('bench.csv')")
