"""Files of a project that are proposed for variables without a value and for missing files."""

import scipy

from kennfeld.base.errors import Location
from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.importers.simulink.value_proposals import propose_files
from kennfeld.importers.simulink.variables.file_search import FileSearch
from tests.importers.simulink.simulink_data import entry, sldd
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import alone, run


def proposals(folder, undefined, failures=None, missing=None, **search):
    """Proposals for a model in `folder`: for each, key, file, variables and what needs it."""
    proposed = propose_files(folder / "m.slx", FileSearch(**search), undefined, failures or {}, missing or {})
    return [(each.key, each.path.relative_to(folder).as_posix(), each.names, each.needed_by) for each in proposed]


def write(folder, **texts):
    """Write scripts by name, `__` for a folder."""
    for name, text in texts.items():
        path = folder.joinpath(*name.split("__")).with_suffix(".m")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_the_script_that_defines_most_comes_first(tmp_path):
    write(tmp_path, a="K = 1;", b="K = 2; L = 3; if K, M = 4; end", c="N = 1;")
    assert proposals(tmp_path, ["K", "L", "M", "N", "O"]) == [
        ("parameters", "b.m", ("K", "L", "M"), ""),
        ("parameters", "c.m", ("N",), ""),
    ]


def test_data_files_and_dictionaries_are_proposed(tmp_path):
    (tmp_path / "data").mkdir()
    scipy.io.savemat(tmp_path / "data" / "v.mat", {"K": 1.0, "unused": 2.0})
    (tmp_path / "d.sldd").write_bytes(sldd({"L": entry(1.0), "M": entry(1.0)}))
    assert proposals(tmp_path, ["K", "L", "M"]) == [
        ("parameters", "d.sldd", ("L", "M"), ""),
        ("parameters", "data/v.mat", ("K",), ""),
    ]


def test_a_script_counts_with_what_it_runs_and_loads(tmp_path):
    scipy.io.savemat(tmp_path / "v.mat", {"K": 1.0})
    write(tmp_path, setup="gains;\nrun('tables.m')\nload v\n", gains="L = 1;", tables="M = 1;\nsetup\n")
    assert proposals(tmp_path, ["K", "L", "M"]) == [("parameters", "setup.m", ("K", "L", "M"), "")]


def test_fields_of_structs_are_distinguished(tmp_path):
    write(tmp_path, one="par.L = 1;", two="par.K = 2;", three="data = struct('K', 1);")
    assert proposals(tmp_path, ["par.K", "data.K"]) == [
        ("parameters", "three.m", ("data.K",), ""),
        ("parameters", "two.m", ("par.K",), ""),
    ]


def test_variables_of_functions_do_not_count_but_those_that_they_assign_in_the_workspace_do(tmp_path):
    write(tmp_path, f="function y = f(x)\nK = 1;\ny = K * x;\nend\n", g="function g\nassignin('base', 'L', 2)\nend\n")
    assert proposals(tmp_path, ["K", "L"]) == [("parameters", "g.m", ("L",), "")]


def test_classes_of_enumerations_are_proposed_by_their_folder(tmp_path):
    for name in ("Gear", "Mode"):
        write(tmp_path, **{f"enum__{name}": f"classdef {name} < Simulink.IntEnumType\nenumeration\nOne(1)\nend\nend"})
    assert proposals(tmp_path, ["Gear.One", "Mode.One", "Mode.Two"]) == [
        ("folders", "enum/Gear.m", ("Gear.One", "Mode.One"), "")
    ]


def test_missing_files_are_proposed_by_their_folder_with_what_they_define(tmp_path):
    (tmp_path / "data").mkdir()
    scipy.io.savemat(tmp_path / "data" / "v.mat", {"K": 1.0})
    missing = {r"C:\work\v.mat": "init.m", "lost.mat": "init.m"}
    assert proposals(tmp_path, ["K", "L"], missing=missing) == [("folders", "data/v.mat", ("K",), "init.m")]


def test_nothing_replaces_what_a_file_in_use_fails_to_define(tmp_path):
    write(tmp_path, init="K = nowhere(1);", other="K = 2;", called="L = nowhere(1);")
    assert proposals(tmp_path, ["K"], given=(tmp_path / "init.m",)) == []
    assert proposals(tmp_path, ["L"], failures={"L": Location("called.m", 1)}) == []


def test_files_of_the_project_above_the_model_are_searched_and_no_others(tmp_path):
    model = tmp_path / "project" / "models"
    write(tmp_path, project__scripts__init="K = 1;", K="K = 2; L = 3;", project__models__slprj__x="L = 1;")
    assert propose_files(model / "m.slx", FileSearch(), ["K", "L"], {}, {}) == ()
    (tmp_path / "project" / "engine.prj").write_text("")
    (own,) = propose_files(model / "m.slx", FileSearch(), ["K", "L"], {}, {})
    assert (own.path, own.names) == (tmp_path / "project" / "scripts" / "init.m", ("K",))


def test_links_and_broken_files_do_not_stop_the_search(tmp_path):
    write(tmp_path, init="K = 1;")
    (tmp_path / "round").symlink_to(tmp_path)
    (tmp_path / "v.mat").write_bytes(b"no data")
    (tmp_path / "d.sldd").write_bytes(b"PK\3\4")
    (tmp_path / "x.m").write_bytes(b"\xff\xfe K = ((( \n")
    assert proposals(tmp_path, ["K"]) == [("parameters", "init.m", ("K",), "")]


def test_nothing_of_a_proposed_script_runs(tmp_path):
    write(tmp_path, init="K = 1; while true, end")
    assert proposals(tmp_path, ["K"]) == [("parameters", "init.m", ("K",), "")]


def report(folder, **options):
    return import_simulink(alone("Gain", Gain="K*L").write(folder), **options).report


def test_the_report_proposes_the_option_and_the_key(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, init_x="K = 1; L = 2;", init_y="K = 3; L = 2;")
    texts = [*map(str, report(tmp_path).findings)]
    assert texts == [
        "K, L are set in init_x.m. Add it with --parameters init_x.m, or to parameters under [model] of a project. "
        "Also in init_y.m: choose one."
    ]
    assert texts[0] in report(tmp_path).sentences
    assert report(tmp_path, parameters=["init_x.m"]).whole


def test_a_missing_file_comes_before_what_follows_from_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, init="load gains\nL = 1;")
    first, second = map(str, report(tmp_path, parameters=["init.m"]).findings)
    assert first.startswith("init.m: needs gains.mat, which was not found.")
    assert second.startswith("variable K: undefined")
    (tmp_path / "sub").mkdir()
    scipy.io.savemat(tmp_path / "sub" / "gains.mat", {"K": 2.0})
    (only,) = map(str, report(tmp_path, parameters=["init.m"]).findings)
    assert only.startswith("init.m: needs gains.mat, which is in sub; K is set in it. Add it with --folder sub, or to")
    assert report(tmp_path, parameters=["init.m"], folders=["sub"]).whole


def test_many_undefined_variables_are_one_finding_beyond_the_first(tmp_path):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    for at in range(30):
        drawn.block("Gain", f"G{at}", Gain=f"K{at}")
        drawn.outport(f"y{at}")
        drawn.line(f"G{at}", f"y{at}")
    drawn.line("u", *(f"G{at}" for at in range(30)))
    findings = import_simulink(drawn.write(tmp_path)).report.findings
    assert len(findings) == 7
    assert str(findings[-1]).startswith("variable K6: undefined, as are K7, K8,")


def test_the_file_that_declares_a_data_store_is_proposed(tmp_path):
    drawn = alone("Gain")
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="held")
    drawn.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="held")
    drawn.line("B", "W")
    drawn.outport("z")
    drawn.line("R", "z")
    write(tmp_path, stores="held = Simulink.Signal; held.InitialValue = '3';", other="K = 1;")
    path = drawn.write(tmp_path, "slx parts")
    (proposal,) = import_simulink(path).report.proposals
    assert (proposal.path.name, proposal.names) == ("stores.m", ("held",))
    assert import_simulink(path, parameters=[tmp_path / "stores.m"]).report.whole


def test_the_function_that_describes_a_bus_is_proposed(tmp_path):
    model = Model(step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    model.block("Constant", "Zero", ports=(0, 1), Value="0", OutDataTypeStr="Bus: State")
    model.block("BusAssignment", "Set", ports=(2, 1), AssignedSignals="speed")
    model.block("BusSelector", "Pick", ports=(1, 2), OutputSignals="speed,torque")
    model.line("Zero", "Set:1")
    model.line("u", "Set:2")
    model.line("Set", "Pick")
    for at, name in enumerate(("n", "m"), 1):
        model.outport(name)
        model.line(f"Pick:{at}", name)
    rows = (f"{{'{name}', 1, 'double', -1, 'real', 'Sample', 'Fixed', [], [], '', ''}}" for name in ("speed", "torque"))
    described = f"info = {{{{'State', '', '', 'Auto', '-1', {{{'; '.join(rows)}}}}}}}'"
    write(tmp_path, state=f"function info = state(varargin)\n{described};\nSimulink.Bus.cellToObject(info)\nend\n")
    write(tmp_path, other="State_0 = 1; torque = 'State';")
    path = model.write(tmp_path)
    report = import_simulink(path).report
    assert "its input 1 is a bus, but the bus State is not defined" in {each.why for each in report.unsupported}
    assert [(each.path.name, each.names) for each in report.proposals] == [("state.m", ("State",))]
    outputs = run(import_simulink(path, parameters=[tmp_path / "state.m"]).require_model(), {"u": [1.0, 2.0]})
    assert outputs["n"].tolist() == [1.0, 2.0]
    assert outputs["m"].tolist() == [0.0, 0.0]
