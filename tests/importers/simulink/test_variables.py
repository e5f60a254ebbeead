"""The variables that parameter files and scripts give to a model."""

import io
from pathlib import Path

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Map, Scalar
from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.importers.simulink.reader.document import document
from kennfeld.importers.simulink.variables.file_search import FileSearch
from kennfeld.importers.simulink.variables.model_variables import collect_variables
from tests.importers.simulink.simulink_data import Thing, entry, matfile, sldd
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import alone, imported, run


def variables(folder, script=None, sources=()):
    """The variables of a model without any of its own, whose script is `init.m`."""
    if script is not None:
        (folder / "init.m").write_text(script)
        sources = (*sources, folder / "init.m")
    return collect_variables(document(Model().written("slx parts"), Path(folder / "m.slx")), sources)


def saved(folder, values, name="data.mat"):
    stream = io.BytesIO()
    scipy.io.savemat(stream, values)
    (folder / name).write_bytes(stream.getvalue())


def parameter():
    return Thing("Simulink.Parameter", {"Value": [[2.0, 3.0]], "Min": 0.0, "Max": 9.0, "DocUnits": "Nm"})


def test_a_script_uses_what_it_loads(tmp_path):
    saved(tmp_path, {"M": np.arange(6.0).reshape(2, 3), "S": {"a": 4.0}, "n": np.int16(7)})
    workspace = variables(tmp_path, "load data.mat\nK = M(2, 3)*S.a;\nn2 = double(n)/2;")
    assert workspace.findings == []
    assert (workspace["K"].value.item(), workspace["n2"].value.item()) == (20.0, 3.5)
    assert workspace["M"].value.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize("script", ["load data.mat", None])
def test_objects_of_a_data_file_keep_limits_and_units(tmp_path, script):
    (tmp_path / "data.mat").write_bytes(matfile({"P": parameter(), "K": 2.5}))
    workspace = variables(tmp_path, script, () if script else (tmp_path / "data.mat",))
    p = workspace["P"]
    assert (p.value.tolist(), p.lower, p.upper, p.unit) == ([[2.0, 3.0]], 0.0, 9.0, "Nm")
    assert workspace["K"].value.item() == 2.5


def test_a_damaged_data_file_is_reported_at_its_load_statement(tmp_path):
    saved(tmp_path, {"A": 1.0, "B": np.arange(100.0)})
    whole = (tmp_path / "data.mat").read_bytes()
    (tmp_path / "data.mat").write_bytes(whole[:-40])
    workspace = variables(tmp_path, "K = 1;\nload data.mat\nL = 2;")
    assert "data.mat: the MATLAB file is damaged" in str(workspace.findings[0])
    assert set(workspace) == {"K", "L"}


def test_a_damaged_data_file_is_read_up_to_the_damage(tmp_path):
    saved(tmp_path, {"A": 1.0, "B": np.arange(100.0)})
    whole = (tmp_path / "data.mat").read_bytes()
    (tmp_path / "data.mat").write_bytes(whole[:-40])
    workspace = variables(tmp_path, sources=(tmp_path / "data.mat",))
    assert set(workspace) == {"A"}
    assert "cannot be read whole" in str(workspace.findings[0])


def test_a_script_loads_no_file_of_another_folder(tmp_path):
    (tmp_path / "m").mkdir()
    saved(tmp_path, {"A": 1.0})
    workspace = variables(tmp_path / "m", "load ../data.mat")
    assert "A" not in workspace
    assert workspace.findings


def test_a_variable_without_a_new_value_loses_its_old_one(tmp_path):
    (tmp_path / "first.m").write_text("K = 1; L = 1; M = 1; N = 1;")
    workspace = variables(tmp_path, "K = nowhere(3); L = 2; N = nowhere(4);", [tmp_path / "first.m", {"N": 7.0}])
    assert {name: workspace[name].value.item() for name in workspace} == {"L": 2.0, "M": 1.0, "N": 7.0}
    assert "K remains undefined" in str(workspace.findings[0])


@pytest.mark.parametrize(
    "loading",
    [
        "load('sub/deep/x.mat')",
        "load(fullfile('sub', 'deep', 'x'))",
        "here = fileparts(mfilename('fullpath'));\nload(fullfile(here, 'sub', 'deep', 'x.mat'))",
        "[here, name, ending] = fileparts(mfilename('fullpath'));\nload([here '/sub/deep/x' ending])",
        "load(['sub' filesep 'deep' filesep 'x.mat'])",
        "load sub/deep/x.mat",
        "load('.\\sub\\deep\\x.mat')",
    ],
)
def test_a_script_loads_files_from_folders_below_its_own(loading, tmp_path):
    (tmp_path / "sub" / "deep").mkdir(parents=True)
    saved(tmp_path / "sub" / "deep", {"K": 4.0}, "x.mat")
    (tmp_path / "init.m").write_text(f"{loading}\nL = K + 1;\n")
    workspace = variables(tmp_path, sources=[tmp_path / "init.m"])
    assert workspace["L"].value.item() == 5.0


def test_a_script_loads_nothing_from_folders_above_its_own(tmp_path):
    (tmp_path / "m").mkdir()
    saved(tmp_path, {"K": 4.0}, "x.mat")
    for name in ("../x.mat", "./../x.mat", str(tmp_path / "x.mat")):
        (tmp_path / "m" / "init.m").write_text(f"load('{name}')\n")
        assert "K" not in variables(tmp_path, sources=[tmp_path / "m" / "init.m"])


def test_a_field_of_a_struct_that_a_script_cannot_compute_leaves_the_others(tmp_path):
    (tmp_path / "init.m").write_text("par.K = 3;\npar.opt = simset('Solver', 'ode3');\n")
    model = imported(alone("Gain", Gain="par.K"), tmp_path, parameters=[tmp_path / "init.m"])
    assert run(model, {"u1": [2.0]})["y1"].tolist() == [6.0]
    report = import_simulink(alone("Gain", Gain="par.opt").write(tmp_path), parameters=[tmp_path / "init.m"]).report
    assert "variable par.opt: undefined (assignment failed in init.m line 2)" in str(report.findings[0])


def workspace_of(folder, code, sources):
    """The variables of a model whose workspace is made by code."""
    return collect_variables(document(Model(code=code).written("slx parts"), Path(folder / "m.slx")), sources)


def test_sources_supply_what_the_code_of_a_workspace_leaves_undefined(tmp_path):
    (tmp_path / "init.m").write_text("K = 3;")
    workspace = workspace_of(tmp_path, "K = nowhere(3);", [tmp_path / "init.m"])
    assert workspace["K"].value.item() == 3.0


def test_a_value_hidden_by_the_model_workspace_is_reported(tmp_path):
    workspace = workspace_of(tmp_path, "K = 2; L = 5;", [{"K": 3.0, "L": 5.0, "M": 1.0}])
    assert {name: workspace[name].value.item() for name in workspace} == {"K": 2.0, "L": 5.0, "M": 1.0}
    (finding,) = workspace.findings
    assert str(finding).startswith("m K: is also defined in the model workspace")
    over = workspace_of(tmp_path, "K = 2;", [ParameterSet([Scalar("K", 3.0)])])
    assert over["K"].value.item() == 3.0


def test_a_table_from_a_calibration_file_is_never_scrambled_into_the_size_of_another(tmp_path):
    calibration = ParameterSet([Map("M", [0, 1, 2], [0, 1], np.arange(6.0).reshape(3, 2)), Block("row", [5.0, 6.0])])
    workspace = variables(tmp_path, "M = [1 2 3; 4 5 6]; row = [1; 2];", [calibration])
    assert workspace["M"].value.tolist() == [[0, 1], [2, 3], [4, 5]]
    assert workspace["row"].value.tolist() == [[5], [6]]


@pytest.mark.parametrize("value", [None, 1 + 2j, np.array([1j, 2.0])])
def test_an_unusable_value_is_reported_by_its_name(tmp_path, value):
    with pytest.raises(InputError, match=r"parameters: K=.* is not a supported value\. Use numbers"):
        variables(tmp_path, sources=[{"K": value, "L": 1.0}])


def test_a_missing_dictionary_is_an_error_if_requested_and_a_finding_otherwise(tmp_path):
    with pytest.raises(InputError, match=r"lost.sldd: file not found"):
        variables(tmp_path, sources=[tmp_path / "lost.sldd"])
    own = document(Model(dictionary="lost.sldd").written("slx parts"), Path(tmp_path / "m.slx"))
    assert "lost.sldd: the data dictionary was not found" in str(collect_variables(own, ()).findings[0])


@pytest.mark.parametrize("name", ["data.sldd", "tables/data.sldd"])
def test_a_dictionary_is_read_from_further_folders_or_from_the_sources(name, tmp_path):
    (tmp_path / "tables").mkdir()
    path = tmp_path / "tables" / "data.sldd"
    path.write_bytes(sldd({"K": entry(1.0)}))
    drawn = document(Model(dictionary=name).written("slx parts"), tmp_path / "m.slx")
    for workspace in (
        collect_variables(drawn, (), FileSearch((tmp_path / "tables",))),
        collect_variables(drawn, [path]),
    ):
        assert workspace["K"].value.item() == 1.0
        assert not workspace.findings


def test_a_referenced_dictionary_is_read_from_further_folders_or_from_the_sources(tmp_path):
    (tmp_path / "tables").mkdir()
    part = tmp_path / "tables" / "part.sldd"
    part.write_bytes(sldd({"K": entry(1.0)}))
    (tmp_path / "data.sldd").write_bytes(sldd({"L": entry(2.0)}, ["part.sldd"]))
    drawn = document(Model(dictionary="data.sldd").written("slx parts"), tmp_path / "m.slx")
    assert "part.sldd" in str(collect_variables(drawn, ()).findings[0])
    for workspace in (
        collect_variables(drawn, (), FileSearch((tmp_path / "tables",))),
        collect_variables(drawn, [part]),
    ):
        assert workspace.keys() >= {"K", "L"}
        assert not workspace.findings


def test_a_model_leads_to_no_dictionary_elsewhere(tmp_path):
    (tmp_path / "m").mkdir()
    (tmp_path / "data.sldd").write_bytes(sldd({"K": entry(1.0)}))
    for name in ("../data.sldd", str(tmp_path / "data.sldd")):
        drawn = document(Model(dictionary=name).written("slx parts"), tmp_path / "m" / "m.slx")
        workspace = collect_variables(drawn, ())
        assert "K" not in workspace
        assert "was not found next to the model" in str(workspace.findings[0])
