"""Samples that are not simulated are told, with the reason."""

import json

import numpy as np
import pytest

import kennfeld as kf
from kennfeld import cli

PROJECT = """
[model]
file = "k.kf"
[[dataset]]
files = ["drive.csv"]
[[criterion]]
node = "y"
target = { channel = "m" }
[parameters.T]
initial = 1.0
"""


def columns(*gaps):
    x = np.arange(20.0)
    for gap in gaps:
        x[gap] = np.nan
    return {"time": 0.1 * np.arange(20), "x": x}


@pytest.mark.parametrize(
    ("gaps", "sentence"),
    [
        ([slice(7, 10)], r"3 of 20 samples are not simulated: x has no value at samples 8 to 10 \(0.7 to 0.9 s\)"),
        ([15], r"1 of 20 samples is not simulated: x has no value at sample 16 \(1.5 s\)"),
        ([slice(7, 10), 15], r"4 of 20 .* in 2 gaps, the first one at samples 8 to 10 \(0.7 to 0.9 s\)"),
        ([0, 19], r"2 of 20 .* in 2 gaps, the first one at sample 1 \(0 s\)"),
    ],
)
def test_a_simulation_reports_skipped_samples(gaps, sentence):
    with pytest.warns(kf.InputWarning, match=sentence):
        nodes = kf.simulate("y = PT1(x, 1)", columns(*gaps), {})
    assert nodes.samples == np.isfinite(columns(*gaps)["x"]).sum()
    assert len(nodes.findings) == 1
    assert "The states start anew after each gap; max_gap" in nodes.findings[0].remedy


def test_a_simulation_of_all_samples_reports_nothing():
    data = kf.Dataset.of("d", {"x": columns(5)["x"]}, time=columns()["time"], max_gap=1.0)
    nodes = kf.simulate("y = PT1(x, 1)", data, {})
    assert (nodes.samples, nodes.findings) == (20, ())


def test_points_without_a_value_are_reported_without_time():
    with pytest.warns(kf.InputWarning, match="2 of 3 samples are not simulated: x, u have no value at samples 1 to 2"):
        kf.simulate("y = x + u", {"x": [np.nan, 1.0, 2.0], "u": [1.0, np.nan, 3.0]}, {})


def test_the_command_reports_it_on_stderr_and_in_json(tmp_path, capsys):
    x = ["" if np.isnan(value) else f"{value:g}" for value in columns(slice(7, 10))["x"]]
    rows = [f"{0.1 * k:.1f},{value},{k}" for k, value in enumerate(x)]
    (tmp_path / "drive.csv").write_text("\n".join(["time,x,m", *rows, ""]))
    (tmp_path / "k.kf").write_text("y = PT1(x, T)\n")
    (tmp_path / "k.toml").write_text(PROJECT)
    assert cli.run(["simulate", str(tmp_path / "k.toml")]) == 0
    assert "3 of 20 samples are not simulated: x has no value at samples 8 to 10" in capsys.readouterr().err
    assert cli.run(["simulate", str(tmp_path / "k.toml"), "--json"]) == 0
    captured = capsys.readouterr()
    (dataset,) = json.loads(captured.out)["datasets"]
    assert (dataset["name"], dataset["samples"]) == ("drive", 17)
    gap = {"first": 8, "last": 10, "begin": 0.7, "end": 0.9}
    assert dataset["skipped"] == {"recorded": 20, "skipped": 3, "inputs": {"x": 3}, "gap_count": 1, "gaps": [gap]}
    assert "3 of 20" in captured.err
