"""Operations on bits, against Python's whole numbers."""

import numpy as np
import pytest
from simulink_files import LAYOUTS, Model
from simulink_runs import alone, imported, run, slopes

from kennfeld.errors import InputError

WHOLE = np.array([0.0, 1.0, 5.0, 12.0, 100.0, 217.0, 255.0, -1.0, -37.0, 2.0**31, -(2.0**31)])
OTHER = np.array([3.0, 255.0, 6.0, -4.0, 37.0, 90.0, 128.0, 77.0, -12.0, 2.0**31 + 5, -7.0])
RULES = {"AND": lambda a, b: a & b, "OR": lambda a, b: a | b, "XOR": lambda a, b: a ^ b}


def expected(rule, *columns):
    return [float(rule(*(int(np.floor(one)) for one in row))) for row in zip(*columns, strict=True)]


def typed(kind, inputs, types, **parameters):
    """A block behind conversions to integer types."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.link("B", "simulink/Logic and Bit Operations/x", kind, ports=(inputs, 1), **parameters)
    for at, stated in enumerate(types, 1):
        drawn.inport(f"u{at}")
        drawn.block("DataTypeConversion", f"T{at}", OutDataTypeStr=stated)
        drawn.chain(f"u{at}", f"T{at}")
        drawn.line(f"T{at}", f"B:{at}")
    drawn.outport("y1")
    drawn.line("B", "y1")
    return drawn


MASKS = {"bin2dec('11011001')": 217, "0": 0, "hex2dec('FFFF')": 0xFFFF, "-8": -8, "1": 1}


@pytest.mark.parametrize("kind", sorted(RULES))
@pytest.mark.parametrize("mask", MASKS)
def test_a_mask_is_applied_bit_by_bit(kind, mask, tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop=kind, UseBitMask="on", BitMask=mask)
    found = run(imported(drawn, tmp_path), {"u1": WHOLE})["y1"]
    assert found.tolist() == expected(lambda a: RULES[kind](a, MASKS[mask]), WHOLE)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_says_the_same_of_a_mask(layout, tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop="XOR")
    found = run(imported(drawn, tmp_path, layout), {"u1": WHOLE})["y1"]
    assert found.tolist() == expected(lambda a: a ^ 217, WHOLE)


@pytest.mark.parametrize("kind", sorted(RULES))
def test_two_signals_are_joined_bit_by_bit(kind, tmp_path):
    drawn = alone("Reference", 2, special="Bitwise Operator", logicop=kind, UseBitMask="off", NumInputPorts="2")
    found = run(imported(drawn, tmp_path), {"u1": WHOLE, "u2": OTHER})["y1"]
    assert found.tolist() == expected(RULES[kind], WHOLE, OTHER)


def test_numbers_beyond_32_bits_give_no_result_rather_than_a_wrong_one(tmp_path):
    drawn = alone("Reference", 2, special="Bitwise Operator", logicop="AND", UseBitMask="off", NumInputPorts="2")
    found = run(imported(drawn, tmp_path), {"u1": [2.0**40, 7.0], "u2": [3.0, 3.0]})["y1"]
    assert np.isnan(found[0])
    assert found[1] == 3.0


def test_the_elements_of_a_vector_are_joined_and_masks_may_differ(tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop="XOR", UseBitMask="off")
    drawn.blocks[1].parameters["PortDimensions"] = "3"
    columns = {f"u1[{at}]": WHOLE[at : at + 6] for at in (1, 2, 3)}
    found = run(imported(drawn, tmp_path), columns)["y1"]
    assert found.tolist() == expected(lambda a, b, c: a ^ b ^ c, *columns.values())
    several = alone("Reference", special="Bitwise Operator", logicop="AND", BitMask="[1 6 255]")
    found = run(imported(several, tmp_path), {"u1": WHOLE})
    for at, mask in enumerate((1, 6, 255), 1):
        assert found[f"y1[{at}]"].tolist() == expected(lambda a, m=mask: a & m, WHOLE)


@pytest.mark.parametrize(("stated", "top"), [("uint8", 255), ("int16", -1), ("fixdt(0,16,0)", 65535)])
def test_a_complement_takes_the_integer_type_of_the_input(stated, top, tmp_path):
    u = np.array([0.0, 1.0, 100.0])
    found = run(imported(typed("Bitwise Operator", 1, [stated], logicop="NOT"), tmp_path), {"u1": u})["y1"]
    assert found.tolist() == (top - u).tolist()
    drawn = typed("Bitwise Operator", 1, [stated], logicop="NAND", BitMask="5")
    assert run(imported(drawn, tmp_path), {"u1": u})["y1"].tolist() == [top - (int(one) & 5) for one in u]


def test_a_complement_of_an_unknown_type_is_refused(tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop="NOT")
    with pytest.raises(InputError, match="B: its result depends on the integer type of its input"):
        imported(drawn, tmp_path)
    with pytest.raises(InputError, match="its input has 64 bits"):
        imported(typed("Bitwise Operator", 1, ["uint64"], logicop="NOT"), tmp_path)


def test_the_integer_type_is_found_through_blocks_that_keep_it(tmp_path):
    drawn = typed("Bitwise Operator", 1, ["uint8"], logicop="NOT")
    drawn.block("UnitDelay", "Z", SampleTime="-1")
    drawn.wires[1].ends = [("Z", "in", 1)]
    drawn.line("Z", "B:1")
    assert run(imported(drawn, tmp_path), {"u1": [7.0, 8.0]})["y1"].tolist() == [255.0, 248.0]


def test_single_bits_are_set_and_cleared(tmp_path):
    for kind, rule in (("Bit Set", lambda a: a | 4), ("Bit Clear", lambda a: a & ~4)):
        found = run(imported(alone("Reference", special=kind, iBit="2"), tmp_path), {"u1": WHOLE})["y1"]
        assert found.tolist() == expected(rule, WHOLE)
    with pytest.raises(InputError, match="bit 8 is the sign of its input of 8 bits, or beyond it"):
        imported(typed("Bit Set", 1, ["uint8"], iBit="8"), tmp_path)


def shifted(types, **parameters):
    drawn = typed("x", len(types), types)
    drawn.blocks[0].kind, drawn.blocks[0].parameters, drawn.blocks[0].instance = "ArithShift", parameters, None
    return drawn


def test_shifts_drop_bits_at_both_ends_of_the_word(tmp_path):
    u = np.array([-100.0, -1.0, 0.0, 3.0, 77.0, 127.0])
    found = run(imported(shifted(["int8"], BitShiftDirection="Right", BitShiftNumber="2"), tmp_path), {"u1": u})["y1"]
    assert found.tolist() == [int(one) >> 2 for one in u]
    found = run(imported(shifted(["int8"], BitShiftDirection="Left", BitShiftNumber="2"), tmp_path), {"u1": u})["y1"]
    assert found.tolist() == [np.int8((int(one) << 2) & 0xFF if (int(one) << 2) & 0x80 == 0 else
                              ((int(one) << 2) & 0xFF) - 256) for one in u]  # fmt: skip
    both = shifted(["uint8", "int8"], BitShiftNumberSource="Input port")
    found = run(imported(both, tmp_path), {"u1": [200.0] * 4, "u2": [3.0, -1.0, 0.0, -2.0]})["y1"]
    assert found.tolist() == [25, 400 % 256, 200, 800 % 256]


def test_a_shift_of_an_unknown_type_is_refused(tmp_path):
    with pytest.raises(InputError, match="depends on the integer type"):
        imported(alone("ArithShift", BitShiftNumber="1"), tmp_path)


def test_the_slope_of_bits_is_0(tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop="AND", BitMask="3")
    drawn.block("Gain", "K", Gain="k")
    drawn.wires[0].ends = [("K", "in", 1)]
    drawn.line("K", "B:1")
    model = imported(drawn, tmp_path, parameters=[{"k": 2.37}])
    exact, found = slopes(model, {"u1": WHOLE[:4]}, "k", "y1")
    assert not exact.any()
    assert not found.any()
