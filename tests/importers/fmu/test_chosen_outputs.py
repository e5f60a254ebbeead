"""States, derivatives and other variables of an FMU as nodes."""

import json
import zipfile

import numpy as np
import pytest

import kennfeld as kf
from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.importers.fmu import fmu_info
from kennfeld.importers.fmu.importing import fmu
from tests.draws import mostly_slow
from tests.importers.fmu.lag_fmu import DESCRIPTIONS, SOURCE, build, compile_library, pack
from tests.importers.fmu.tank_fmu import build as build_tank
from tests.importers.fmu.tank_fmu import recording

STEP, COUNT, TAU = 0.1, 30, 0.7
DATA = {"time": np.arange(COUNT) * STEP, "u": np.full(COUNT, 3.0)}
X = 3.0 - 2.0 * (1 - STEP / TAU) ** np.arange(COUNT)  # by Euler's method


@pytest.fixture(scope="module", params=mostly_slow([2, 3], [2]))
def lag(request, tmp_path_factory):
    return build(tmp_path_factory.mktemp("lag"), request.param, "-DLIFT", lift=True)


@pytest.fixture(scope="module", params=mostly_slow([2, 3], [3]))
def silent(request, tmp_path_factory):
    """The lag without outputs."""
    version, folder = request.param, tmp_path_factory.mktemp("silent")
    text = DESCRIPTIONS[version]().replace('causality="output"', 'causality="local"')
    for part in (
        '<Outputs><Unknown index="5" dependencies="2"/></Outputs>',
        '<Output valueReference="4" dependencies="1"/>',
    ):
        text = text.replace(part, "")
    library = compile_library(SOURCE, folder / "lag.so", version)
    return pack(folder / "lag.fmu", text, library=library, version=version)


def test_states_derivatives_and_local_variables_are_nodes(lag):
    model = fmu(lag, solver="ode1", outputs=["x", "der(x)", "lift"])
    assert model.graph.outputs == ("y", "x", "der(x)", "lift")
    nodes = kf.simulate(model, DATA, {"tau": TAU})
    np.testing.assert_allclose(nodes["x"].values, X, rtol=1e-12)
    np.testing.assert_allclose(nodes["der(x)"].values, (3.0 - X) / TAU, rtol=1e-12)
    np.testing.assert_array_equal(nodes["lift"].values, 0.35)
    alone = kf.simulate(fmu(lag, solver="ode1"), DATA, {"tau": TAU})
    np.testing.assert_array_equal(nodes["y"].values, alone["y"].values)


@pytest.mark.parametrize("node", ["x", "der(x)"])
def test_a_fit_may_follow_them(lag, node):
    model = fmu(lag, solver="ode1", outputs=[node])
    data = {**DATA, "target": kf.simulate(model, DATA, {"tau": TAU})[node].values}
    result = kf.calibrate(model, data, {"tau": 1.5}, "target", node=node, free=["tau"])
    assert result.parameters["tau"].value == pytest.approx(TAU, rel=1e-7)


def test_names_may_be_patterns_whose_brackets_are_part_of_the_name(lag):
    assert fmu(lag, outputs=["*x*"]).graph.outputs == ("y", "x", "der(x)")
    with pytest.raises(InputError, match=r"unknown variable \[x\]"):
        fmu(lag, outputs=["[x]"])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("lifd", "unknown variable lifd. Did you mean lift"),
        ("qq*", "unknown variable qq*. `outputs` chooses among its variables: x, der(x), "),
        ("tau", "tau is not a computed number: its causality is parameter, its type "),
    ],
)
def test_other_names_are_errors_that_say_what_can_be_taken(lag, name, message):
    with pytest.raises(InputError) as caught:
        fmu(lag, outputs=[name])
    assert message in str(caught.value)


def test_an_fmu_without_outputs_has_its_states(silent):
    model = fmu(silent, solver="ode1")
    assert model.graph.outputs == ("x",)
    assert "its states are nodes; `outputs` chooses among its variables: x, der(x), y" in str(model.remarks[-1])
    np.testing.assert_allclose(kf.simulate(model, DATA, {"tau": TAU})["x"].values, X, rtol=1e-12)
    assert fmu(silent, outputs=["y"]).graph.outputs == ("y",)


@pytest.mark.parametrize("version", mostly_slow([2, 3], [2]))
def test_variables_of_a_co_simulation_are_nodes(tmp_path, version):
    path, other = build_tank(tmp_path, version), tmp_path / "other.fmu"
    outputs = {2: ('<Unknown index="5"/>', 'name="steps" valueReference="5" causality="output"')}
    outputs[3] = ('<Output valueReference="5"/>', outputs[2][1])
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(other, "w") as new:
        for name in old.namelist():
            listed, declared = (text.encode() for text in outputs[version])
            local = declared.replace(b"output", b"local")
            new.writestr(name, old.read(name).replace(listed, b"").replace(declared, local))
    model = fmu(other, outputs=["steps"])
    assert model.graph.outputs == ("y", "high", "steps")
    nodes = kf.simulate(model, recording(), {})
    np.testing.assert_array_equal(nodes["steps"].values, 3 + np.arange(len(nodes["y"].values)))


def test_a_project_chooses_them(tmp_path, lag):
    text = f"""[model]
file = "{lag.as_posix()}"
outputs = ["der(*)"]
[[dataset]]
files = ["bench.csv"]
[[criterion]]
node = "der(x)"
target = 1.0
"""
    (tmp_path / "bench.csv").write_text("time,u\n0,1\n0.1,1\n0.2,1\n")
    (tmp_path / "kennfeld.toml").write_text(text)
    assert kf.Project.read(tmp_path / "kennfeld.toml").problem().model.graph.outputs == ("y", "der(x)")


def test_info_lists_what_can_be_chosen(silent, capsys):
    assert cli.run(["info", str(silent)]) == 0
    printed = capsys.readouterr().out
    assert "other variable" in printed
    assert "der(x)" in printed
    assert "makes other variables nodes" in printed


def test_info_counts_the_variables_that_its_table_leaves_out(silent, capsys, monkeypatch):
    monkeypatch.setattr(fmu_info, "_MOST_OTHERS", 1)
    assert cli.run(["info", str(silent), "--json"]) == 0
    # its states are its outputs already
    others = len(json.loads(capsys.readouterr().out)["other_variables"])
    assert cli.run(["info", str(silent)]) == 0
    assert f"; {others - 1} more are listed by --json" in capsys.readouterr().out
