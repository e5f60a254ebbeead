"""The record of a block type is all that the importer needs, so that a new block needs no other module."""

import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.lowering import ARITHMETIC, BLOCK_TYPES, LIKE_INPUT, OutputType
from kennfeld.importers.simulink.lowering.registry import COMPUTED, BlockType, maskable_types, opaque_mask_types
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import imported, run


@pytest.fixture
def register(monkeypatch):
    """Register a block type that returns its input, for the time of a test."""

    def enter(name, **fields):
        monkeypatch.setitem(BLOCK_TYPES, name, BlockType(name, lambda block: block.input(), {}, **fields))

    return enter


def complement(kind, integer_type="int8"):
    """The complement of an input that is converted to an integer type and then passes through a block."""
    model = Model(step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    model.block("DataTypeConversion", "T", OutDataTypeStr=integer_type)
    model.block(kind, "New", ports=(1, 1))
    model.link("B", "simulink/Logic and Bit Operations/x", "Bitwise Operator", ports=(1, 1), logicop="NOT",
               UseBitMask="off")  # fmt: skip
    model.outport("y")
    model.chain("u", "T", "New", "B", "y")
    return model


def test_an_output_has_the_integer_type_of_the_input_that_the_record_names(register, tmp_path):
    register("Repeater", output=LIKE_INPUT)
    assert run(imported(complement("Repeater"), tmp_path), {"u": [-39.0, 0.0, 38.0]})["y"].tolist() == [
        38.0,
        -1.0,
        -39.0,
    ]


def test_without_it_the_type_of_the_output_is_unknown(register, tmp_path):
    register("Repeater")
    with pytest.raises(InputError, match="Specify an integer output type"):
        imported(complement("Repeater"), tmp_path)


@pytest.mark.parametrize(
    ("output", "converts"),
    [(COMPUTED, True), (ARITHMETIC, True), (LIKE_INPUT, False), (OutputType(states=True), False)],
)
def test_a_specified_integer_type_is_a_conversion_unless_it_is_only_stated(output, converts):
    assert output.converts is converts


def test_a_mask_of_one_word_is_one_of_the_library_if_its_record_says_so(register):
    register("Repeater")
    register("Echo", library_mask=True)
    register("Two Words")
    assert {"Echo", "Two Words", "Ramp"} <= opaque_mask_types()
    assert maskable_types()["Echo"]
    assert not maskable_types()["Repeater"]
