"""A Simulink model takes part in the search for missing terms: the node and its block are named, nothing is written."""

import numpy as np

from kennfeld import cli
from tests.importers.simulink.simulink_files import Model

PROJECT = """[model]
file = "drag.slx"

[[dataset]]
name = "bench"
files = ["bench.csv"]

[[criterion]]
node = "torque"
target = { channel = "m" }

[parameters.Factor]
initial = 1.0

[parameters.Slope]
initial = 0.2
"""


def write_bench(folder):
    root = Model("drag")
    losses = root.subsystem("Losses")
    losses.block("Gain", "Friction", Gain="Slope")
    losses.between(["n"], "Friction", ["drag"])
    root.inport("load")
    root.inport("speed")
    root.block("Gain", "Inner", Gain="Factor")
    root.block("Sum", "Difference", Inputs="+-", ports=(2, 1))
    root.outport("torque")
    root.chain("load", "Inner", "Difference", "torque")
    root.chain("speed", "Losses")
    root.line("Losses", "Difference:2")
    root.write(folder)
    rng = np.random.default_rng(0)
    load, speed, oil = rng.uniform(0, 1, (3, 300))
    m = 2 * load - 0.5 * speed * (1 + 0.8 * oil) + 0.005 * rng.normal(size=300)
    rows = [",".join(f"{x:.6f}" for x in row) for row in zip(load, speed, oil, m, strict=True)]
    (folder / "bench.csv").write_text("\n".join(["load,speed,oil,m", *rows]) + "\n", encoding="utf-8")
    path = folder / "kennfeld.toml"
    path.write_text(PROJECT, encoding="utf-8")
    return path


def test_a_proposal_for_a_simulink_model_names_node_and_block_and_writes_nothing(tmp_path, capsys):
    path = write_bench(tmp_path)
    before = {file: file.read_bytes() for file in (path, tmp_path / "drag.slx")}
    assert cli.run(["propose", str(path), "--kind", "multiply", "--apply", "1"]) == 2
    error = capsys.readouterr().err
    assert "drag.slx is not formula text, into which terms are written; nothing was changed" in error
    assert "by a curve of oil where the function was made: node " in error
    assert "Losses" in error
    assert {file: file.read_bytes() for file in before} == before
