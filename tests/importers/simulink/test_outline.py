import json
from pathlib import Path

import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.outline import summarize_model
from tests.importers.simulink.simulink_data import Thing, entry, mxarray, sldd, thing
from tests.importers.simulink.simulink_files import LAYOUTS, Chart, Mask, Model

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "simulink"


def engine(**options):
    model = Model("engine", callbacks={"InitFcn": "\nk = 1;\nm = 2;"}, dictionary="engine.sldd", **options)
    model.inport("n", Unit="rpm")
    model.inport("load")
    torque = model.subsystem("Torque", mask=Mask({"a": "1", "b": "2"}))
    torque.block("EnablePort", "Enable")
    torque.inport("u")
    torque.block("Gain", "K", Gain="a")
    torque.outport("y")
    model.link("R", "mylib/Ramp", "Ramp")
    model.link("C", "simulink/Sources/Compare\nTo Zero", "Compare To Zero")
    model.link("X", "other/Thing")
    model.block("ModelReference", "P", ModelNameDialog="plant.slx")
    model.function("F", "function y = f(u)\ny = u;")
    model.chart("Shift", Chart({"A": "A"}, [("", "A", "")], []))
    model.outport("y", Unit="inherit")
    return model


@pytest.fixture(params=LAYOUTS)
def path(request, tmp_path):
    library = Model("mylib", kind="Library")
    library.subsystem("Ramp").block("Gain", "K")
    library.write(tmp_path, request.param)
    Model("plant").write(tmp_path, "slx parts")
    limits = thing("Simulink.Parameter", Value=entry(1.0))
    (tmp_path / "engine.sldd").write_bytes(sldd({"K": limits, "Z": '<P Name="Value" Class="odd">1</P>'}))
    return engine(workspace=mxarray({"P": Thing("Simulink.Parameter", {"Value": 1.0}), "q": 2.0})).write(
        tmp_path, request.param
    )


def test_interfaces_and_blocks_are_listed(path):
    outline = summarize_model(path)
    assert [(port.name, port.unit) for port in outline.inputs] == [("n", "rpm"), ("load", "")]
    assert [(port.name, port.unit) for port in outline.outputs] == [("y", "")]
    assert outline.blocks["Gain"] == 2
    assert list(outline.blocks.values()) == sorted(outline.blocks.values(), reverse=True)
    kinds = {inner.path: (inner.kind, inner.inputs, inner.outputs, inner.blocks) for inner in outline.subsystems}
    assert kinds["Torque"] == ("masked, enabled", ("u",), ("y",), 4)
    assert kinds["F"] == ("MATLAB Function", ("u",), ("y",), 2)
    assert kinds["R"][3] == 1
    assert outline.charts == (("Shift", "Chart", 1, 1),)
    assert outline.functions == (("F", 2),)


def test_links_and_sources_name_their_origin(path):
    outline = summarize_model(path)
    links = {link.source: link.found for link in outline.connections}
    assert links["mylib/Ramp"].startswith("mylib.")
    assert links["plant.slx"] == "plant.slx"
    assert (links["simulink/Sources/Compare To Zero"], links["other/Thing"]) == ("Simulink", "not found")
    sources = [(source.kind, source.name, source.content) for source in outline.sources]
    assert sources == [
        ("model workspace", "in the file", "2 variables"),
        ("callback", "InitFcn", "k = 1; ... (2 lines)"),
        ("data dictionary", "engine.sldd", "1 variables, unreadable: Z"),
        ("masks", "", "2 parameters"),
    ]


def test_an_outline_is_json(path):
    outline = json.loads(json.dumps(summarize_model(path).as_dict()))
    assert outline["charts"] == [{"path": "Shift", "kind": "Chart", "states": 1, "transitions": 1}]
    assert outline["solver"]["name"] == "ode4"


def test_missing_and_broken_files_of_the_model_are_reported(tmp_path):
    path = engine().write(tmp_path)
    assert {source.content for source in summarize_model(path).sources} >= {"not found"}
    (tmp_path / "engine.sldd").write_bytes(b"PK\3\4")
    (tmp_path / "mylib.slx").write_bytes(b"PK\3\4")
    outline = summarize_model(path)
    assert [source.content for source in outline.sources if source.kind == "data dictionary"] == ["unreadable"]
    assert sorted(str(problem).partition(":")[0] for problem in outline.problems) == ["engine.sldd", "mylib.slx"]


def test_a_broken_model_is_refused(tmp_path):
    (tmp_path / "m.slx").write_bytes(b"PK\3\4")
    with pytest.raises(InputError, match=r"m\.slx: is a damaged zip archive"):
        summarize_model(tmp_path / "m.slx")


def test_a_real_model_is_described(tmp_path):
    if not DATA.is_dir():
        pytest.skip(f"the models are not at {DATA}")
    outline = summarize_model(DATA / "AbstractFuelControl_M1.slx")
    assert (outline.version, outline.solver.name) == ("R2017b", "ode15s")
    assert sum(outline.blocks.values()) == 301


def test_a_link_to_a_library_that_is_not_at_hand_is_built_in_if_its_meaning_is_known(tmp_path):
    drawn = Model()
    drawn.link("A", "aerolibconvert2/Angle Conversion", "Angle Conversion", IU="deg", OU="rad")
    drawn.link("M", "dspstat3/Mean", "Mean")
    drawn.link("N", "own/Mean", "Mean")
    outline = summarize_model(drawn.write(tmp_path, "slx parts"))
    assert {link.source: link.found for link in outline.connections} == {
        "aerolibconvert2/Angle Conversion": "built in", "dspstat3/Mean": "built in", "own/Mean": "not found",
    }  # fmt: skip
