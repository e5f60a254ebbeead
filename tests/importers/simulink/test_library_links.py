from dataclasses import replace

import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.reader import library_links
from kennfeld.importers.simulink.reader.document import read_document
from kennfeld.importers.simulink.reader.library_links import LibraryResolver
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Mask, Model
from tests.importers.simulink.simulink_runs import imported


def library(name="mylib"):
    """A library with a masked subsystem, a plain block, and a block in a block."""
    drawn = Model(name, kind="Library", defaults={"Gain": {"Multiplication": "Element-wise(K.*u)"}})
    ramp = drawn.subsystem("Ramp\nup", mask=Mask({"slope": "1", "start": "0"}, "Ramp"))
    ramp.inport("u")
    ramp.block("Gain", "K", Gain="slope")
    ramp.outport("y")
    ramp.chain("u", "K", "y")
    drawn.block("Gain", "Half", Gain="0.5", SaturateOnIntegerOverflow="off")
    drawn.subsystem("Group").block("Constant", "a/b", Value="7")
    return drawn


def resolved(model, folder, layout="slx parts", folders=()):
    return LibraryResolver(folders).resolve(read_document(model.write(folder, layout)))


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl"]))
def test_a_link_takes_the_content_of_the_library_with_its_own_parameters(layout, tmp_path):
    library().write(tmp_path, layout)
    model = Model()
    engine = model.subsystem("Engine")
    engine.link("Ramp 1", "mylib/Ramp up", "Ramp", slope="k1*2")
    result = resolved(model, tmp_path, layout)
    block = result.document.root.at("Engine/Ramp 1")
    assert (block.type, block.name, block.path) == ("SubSystem", "Ramp 1", "Engine/Ramp 1")
    assert {p.name: p.expression for p in block.mask.parameters} == {"slope": "k1*2", "start": "0"}
    inner = result.document.root.at("Engine/Ramp 1/K")
    assert (inner.path, inner.value("Gain"), inner.value("Multiplication")) == (
        "Engine/Ramp 1/K",
        "slope",
        "Element-wise(K.*u)",
    )
    assert len(block.system.lines) == 2
    assert (dict(result.missing), result.problems) == ({}, ())


def test_a_link_to_a_plain_block_is_that_block(tmp_path):
    library().write(tmp_path)
    model = Model()
    model.link("H", "mylib/Half", Gain="0.25")
    model.link("C", "mylib/Group/a//b", ports=(0, 1))
    root = resolved(model, tmp_path).document.root
    assert root.at("H").type == "Gain"
    assert (root.at("H").value("Gain"), root.at("H").value("SaturateOnIntegerOverflow")) == ("0.25", "off")
    assert root.at("C").value("Value") == "7"


def test_libraries_are_looked_for_in_further_folders_and_links_lead_on(tmp_path):
    (tmp_path / "libs").mkdir()
    library().write(tmp_path / "libs", "mdl")
    outer = Model("outer", kind="Library")
    outer.subsystem("Twice").link("first", "mylib/Ramp up", slope="9")
    outer.link("Again", "mylib/Half", Gain="3")
    outer.write(tmp_path)
    model = Model()
    model.link("T", "outer/Twice")
    model.link("A", "outer/Again")
    result = resolved(model, tmp_path, folders=[tmp_path / "libs"])
    assert result.document.root.at("T/first/K").path == "T/first/K"
    assert result.document.root.at("T/first").mask.parameters[0].expression == "9"
    again = result.document.root.at("A")
    assert (again.type, again.value("Gain"), again.reference.source) == ("Gain", "3", "outer/Again")
    assert set(result.files) == {"outer", "mylib"}


def test_links_of_simulink_itself_stay_links(tmp_path):
    model = Model()
    model.link("C", "simulink/Logic and Bit\nOperations/Compare\nTo Constant", "Compare To Constant", const="3")
    result = resolved(model, tmp_path)
    block = result.document.root.at("C")
    assert (block.type, block.reference.type, block.value("const")) == ("Reference", "Compare To Constant", "3")
    assert (dict(result.missing), result.problems) == ({}, ())


def test_links_without_a_file_are_listed_with_the_blocks_that_use_them(tmp_path):
    model = Model()
    model.link("A", "nolib/X")
    model.subsystem("S").link("B", "nolib/X")
    model.link("C", "../../etc/passwd")
    result = resolved(model, tmp_path)
    assert result.missing["nolib/X"] == ("A", "S/B")
    assert result.document.root.at("A").type == "Reference"
    assert len(result.missing) == 2


def test_a_library_may_link_to_itself_by_its_own_name(tmp_path):
    blocks = library()
    blocks.link("Other", "$bdroot/Half", Gain="5")
    blocks.write(tmp_path)
    model = Model()
    model.link("O", "mylib/Other")
    result = resolved(model, tmp_path)
    assert (result.document.root.at("O").type, result.document.root.at("O").value("Gain")) == ("Gain", "5")


def test_libraries_that_use_their_own_name_may_link_to_one_another(tmp_path):
    for name, other in (("first", "second/Outer"), ("second", "$bdroot/Inner")):
        blocks = Model(name, kind="Library")
        blocks.block("Gain", "Inner", Gain="5" if name == "second" else "3")
        blocks.link("Outer", "$bdroot/Middle")
        blocks.link("Middle", other)
        blocks.write(tmp_path)
    model = Model("top")
    model.link("O", "first/Outer")
    model.link("I", "$bdroot/Group/K")
    model.subsystem("Group").block("Gain", "K", Gain="7")
    result = resolved(model, tmp_path)
    assert (result.problems, dict(result.missing)) == ((), {})
    assert [result.document.root.at(name).value("Gain") for name in "OI"] == ["5", "7"]


def test_an_unknown_block_of_a_library_is_reported_with_the_nearest(tmp_path):
    library().write(tmp_path)
    model = Model()
    model.link("A", "mylib/Hallf")
    result = resolved(model, tmp_path)
    assert [str(problem) for problem in result.problems] == [
        "model.slx A: links to mylib/Hallf, which mylib.slx does not contain. Did you mean Half?"
    ]


def test_the_import_does_not_call_a_library_missing_that_lacks_a_block(tmp_path):
    library().write(tmp_path)
    model = Model(solver="FixedStepDiscrete")
    model.link("A", "mylib/Hallf")
    model.between(["u"], "A", ["y"])
    with pytest.raises(InputError, match="A: its link to mylib/Hallf leads to no block of that library"):
        imported(model, tmp_path)


def test_a_loop_of_libraries_is_reported_with_its_chain(tmp_path):
    for name, other in (("one", "two"), ("two", "one")):
        blocks = Model(name, kind="Library")
        blocks.subsystem("S").link("L", f"{other}/S")
        blocks.link("straight", f"{other}/straight")
        blocks.write(tmp_path)
    model = Model()
    model.link("A", "one/S")
    model.link("B", "one/straight")
    messages = [str(problem) for problem in resolved(model, tmp_path).problems]
    assert messages[0].startswith("model.slx A/L/L: links to itself: one/S -> two/S -> one/S")
    assert messages[1].startswith("model.slx B: links to itself: one/straight -> two/straight -> one/straight")


def test_links_that_multiply_without_end_are_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(library_links, "_MAX_BLOCKS", 1000)
    for at in range(25):
        blocks = Model(f"lib{at}", kind="Library")
        inner = blocks.subsystem("S")
        for number in range(4):
            inner.link(f"L{number}", f"lib{at + 1}/S")
        blocks.write(tmp_path)
    model = Model()
    model.link("A", "lib0/S")
    result = resolved(model, tmp_path)
    assert any("blocks after resolving its links" in str(problem) for problem in result.problems)


def test_a_broken_library_is_reported_once(tmp_path):
    (tmp_path / "bad.slx").write_bytes(b"PK\3\4 and no more")
    model = Model()
    model.link("A", "bad/X")
    model.link("B", "bad/X")
    result = resolved(model, tmp_path)
    assert len(result.problems) == 1
    assert str(result.problems[0]).startswith("bad.slx: is a damaged zip archive")
    assert result.missing["bad/X"] == ("A", "B")


@pytest.mark.parametrize("written", ["plant", "plant.slx"])
def test_a_referenced_model_becomes_the_content_of_its_block(written, tmp_path):
    plant = Model("plant", code="K = 2;", solver="ode1")
    plant.inport("u")
    plant.subsystem("S").block("Gain", "G", Gain="K")
    plant.outport("y")
    plant.write(tmp_path)
    model = Model()
    model.block("ModelReference", "P", ports=(1, 1), ModelNameDialog=written)
    model.block("ModelReference", "Q", ports=(1, 1), ModelNameDialog="nowhere")
    result = resolved(model, tmp_path)
    assert result.document.root.at("P/S/G").path == "P/S/G"
    assert result.models[written].workspace.text == "K = 2;"
    assert result.missing["nowhere"] == ("Q",)


def test_a_model_that_refers_to_itself_is_reported(tmp_path):
    model = Model()
    model.block("ModelReference", "P", ModelNameDialog="model")
    result = resolved(model, tmp_path)
    assert "links to itself: model -> model" in str(result.problems[0])


def test_the_document_that_is_resolved_stays_as_it_was(tmp_path):
    library().write(tmp_path)
    model = Model()
    model.link("H", "mylib/Half", Gain="0.25")
    document = read_document(model.write(tmp_path))
    before = replace(document)
    LibraryResolver().resolve(document)
    assert document == before
    assert document.root.at("H").type == "Reference"
