"""Operations on bits, against Python's whole numbers."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

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
    output = run(imported(drawn, tmp_path), {"u1": WHOLE})["y1"]
    assert output.tolist() == expected(lambda a: RULES[kind](a, MASKS[mask]), WHOLE)


# values of int8, and what compiled C gives for them in an int8_t
SMALL = [-128.0, -100.0, -39.0, -1.0, 0.0, 1.0, 38.0, 100.0, 127.0]
IN_C = {
    "u & 217": ("Bitwise Operator", {"logicop": "AND"}, [-128, -104, -39, -39, 0, 1, 0, 64, 89]),
    "u | 217": ("Bitwise Operator", {"logicop": "OR"}, [-39, -35, -39, -1, -39, -39, -1, -3, -1]),
    "u ^ 217": ("Bitwise Operator", {"logicop": "XOR"}, [89, 69, 0, 38, -39, -40, -1, -67, -90]),
    "~(u & 217)": ("Bitwise Operator", {"logicop": "NAND"}, [127, 103, 38, 38, -1, -2, -1, -65, -90]),
    "u | 128": ("Bit Set", {"iBit": "7"}, [-128, -100, -39, -1, -128, -127, -90, -28, -1]),
    "u & ~128": ("Bit Clear", {"iBit": "7"}, [0, 28, 89, 127, 0, 1, 38, 100, 127]),
}


@pytest.mark.parametrize("operation", IN_C)
def test_a_result_has_the_integer_type_of_the_input(operation, tmp_path):
    kind, settings, values = IN_C[operation]
    output = run(imported(typed(kind, 1, ["int8"], **settings), tmp_path), {"u1": SMALL})["y1"]
    assert output.tolist() == values


def test_a_mask_may_be_a_text_of_hexadecimal_digits(tmp_path):
    drawn = typed("Bitwise Operator", 1, ["uint16"], logicop="AND", BitMask="'0F0c'")
    output = run(imported(drawn, tmp_path), {"u1": [65535.0, 4095.0, 10.0]})["y1"]
    assert output.tolist() == [0x0F0C, 0x0F0C, 8.0]


def test_a_constant_without_a_type_takes_that_of_the_other_input(tmp_path):
    drawn = typed("Bitwise Operator", 2, ["int8", "Inherit: Inherit via back propagation"], logicop="AND",
                  UseBitMask="off", NumInputPorts="2")  # fmt: skip
    output = run(imported(drawn, tmp_path), {"u1": SMALL, "u2": [217.0] * len(SMALL)})["y1"]
    assert output.tolist() == IN_C["u & 217"][2]


@pytest.mark.parametrize(
    ("settings", "values"),
    [
        ({}, [250, 254, 2, 3, 44, 56]),
        ({"SaturateOnIntegerOverflow": "on"}, [0, 0, 2, 3, 255, 255]),
        ({"RndMeth": "Ceiling"}, [251, 255, 3, 4, 44, 56]),
        ({"RndMeth": "Zero"}, [251, 255, 2, 3, 44, 56]),
        ({"RndMeth": "Nearest"}, [251, 255, 3, 4, 44, 56]),
        ({"RndMeth": "Round"}, [250, 254, 3, 4, 44, 56]),
        ({"RndMeth": "Convergent"}, [250, 254, 2, 4, 44, 56]),
    ],
)
def test_bits_are_those_of_the_number_that_the_conversion_before_makes(settings, values, tmp_path):
    drawn = typed("Bitwise Operator", 1, ["uint8"], logicop="OR", BitMask="0")
    next(one for one in drawn.blocks if one.name == "T1").parameters |= settings
    output = run(imported(drawn, tmp_path), {"u1": [-5.5, -1.5, 2.5, 3.5, 300.0, 312.0]})["y1"]
    assert output.tolist() == values


def test_stored_bits_are_read_as_another_type(tmp_path):
    drawn = typed("x", 1, ["int8"])
    drawn.blocks[0].kind, drawn.blocks[0].instance = "DataTypeConversion", None
    drawn.blocks[0].parameters = {"OutDataTypeStr": "uint8", "ConvertRealWorld": "Stored Integer (SI)"}
    output = run(imported(drawn, tmp_path), {"u1": [-1.0, -128.0, 100.0]})["y1"]
    assert output.tolist() == [255.0, 128.0, 100.0]


def test_possible_effects_of_an_unknown_type_are_reported(tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop="AND", BitMask="217")
    assert any("B uses its mask as written" in one for one in reported(drawn, tmp_path))
    drawn = alone("Reference", special="Bitwise Operator", logicop="AND", BitMask="127")
    assert reported(drawn, tmp_path) == ()
    assert any("B uses bit 7" in one for one in reported(alone("Reference", special="Bit Set", iBit="7"), tmp_path))


def test_blocks_whose_integers_are_not_applied_are_reported(tmp_path):
    drawn = alone("Gain", Gain="3", OutDataTypeStr="int16")
    assert reported(drawn, tmp_path) == (
        "integer types are ignored in B: Simulink rounds there, and wraps beyond their limits",
    )
    assert reported(alone("UnitDelay", OutDataTypeStr="int16"), tmp_path) == ()


def reported(drawn, folder):
    return tuple(map(str, import_simulink(drawn.write(folder)).report.remarks))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_mask(layout, tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop="XOR")
    output = run(imported(drawn, tmp_path, layout), {"u1": WHOLE})["y1"]
    assert output.tolist() == expected(lambda a: a ^ 217, WHOLE)


@pytest.mark.parametrize("kind", sorted(RULES))
def test_two_signals_are_joined_bit_by_bit(kind, tmp_path):
    drawn = alone("Reference", 2, special="Bitwise Operator", logicop=kind, UseBitMask="off", NumInputPorts="2")
    output = run(imported(drawn, tmp_path), {"u1": WHOLE, "u2": OTHER})["y1"]
    assert output.tolist() == expected(RULES[kind], WHOLE, OTHER)


def test_numbers_beyond_32_bits_give_no_result_rather_than_a_wrong_one(tmp_path):
    drawn = alone("Reference", 2, special="Bitwise Operator", logicop="AND", UseBitMask="off", NumInputPorts="2")
    output = run(imported(drawn, tmp_path), {"u1": [2.0**40, 7.0], "u2": [3.0, 3.0]})["y1"]
    assert np.isnan(output[0])
    assert output[1] == 3.0


def test_the_elements_of_a_vector_are_joined_and_masks_may_differ(tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop="XOR", UseBitMask="off")
    drawn.blocks[1].parameters["PortDimensions"] = "3"
    columns = {f"u1[{at}]": WHOLE[at : at + 6] for at in (1, 2, 3)}
    output = run(imported(drawn, tmp_path), columns)["y1"]
    assert output.tolist() == expected(lambda a, b, c: a ^ b ^ c, *columns.values())
    several = alone("Reference", special="Bitwise Operator", logicop="AND", BitMask="[1 6 255]")
    output = run(imported(several, tmp_path), {"u1": WHOLE})
    for at, mask in enumerate((1, 6, 255), 1):
        assert output[f"y1[{at}]"].tolist() == expected(lambda a, m=mask: a & m, WHOLE)


@pytest.mark.parametrize(("stated", "top"), [("uint8", 255), ("int16", -1), ("fixdt(0,16,0)", 65535)])
def test_a_complement_takes_the_integer_type_of_the_input(stated, top, tmp_path):
    u = np.array([0.0, 1.0, 100.0])
    output = run(imported(typed("Bitwise Operator", 1, [stated], logicop="NOT"), tmp_path), {"u1": u})["y1"]
    assert output.tolist() == (top - u).tolist()
    drawn = typed("Bitwise Operator", 1, [stated], logicop="NAND", BitMask="5")
    assert run(imported(drawn, tmp_path), {"u1": u})["y1"].tolist() == [top - (int(one) & 5) for one in u]


def test_a_complement_of_an_unknown_type_is_refused(tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop="NOT")
    with pytest.raises(InputError, match="B: its result depends on the integer type of its input"):
        imported(drawn, tmp_path)
    with pytest.raises(InputError, match="its input has 64 bits"):
        imported(typed("Bitwise Operator", 1, ["uint64"], logicop="NOT"), tmp_path)


def test_the_integer_type_passes_through_blocks_that_keep_it(tmp_path):
    drawn = typed("Bitwise Operator", 1, ["uint8"], logicop="NOT")
    drawn.block("UnitDelay", "Z", SampleTime="-1")
    drawn.wires[1].ends = [("Z", "in", 1)]
    drawn.line("Z", "B:1")
    assert run(imported(drawn, tmp_path), {"u1": [7.0, 8.0]})["y1"].tolist() == [255.0, 248.0]


def test_single_bits_are_set_and_cleared(tmp_path):
    for kind, rule in (("Bit Set", lambda a: a | 4), ("Bit Clear", lambda a: a & ~4)):
        output = run(imported(alone("Reference", special=kind, iBit="2"), tmp_path), {"u1": WHOLE})["y1"]
        assert output.tolist() == expected(rule, WHOLE)
    with pytest.raises(InputError, match="bit 8 is outside its 8-bit input"):
        imported(typed("Bit Set", 1, ["uint8"], iBit="8"), tmp_path)


def shifted(types, **parameters):
    drawn = typed("x", len(types), types)
    drawn.blocks[0].kind, drawn.blocks[0].parameters, drawn.blocks[0].instance = "ArithShift", parameters, None
    return drawn


def test_shifts_drop_bits_at_both_ends_of_the_word(tmp_path):
    u = np.array([-100.0, -1.0, 0.0, 3.0, 77.0, 127.0])
    output = run(imported(shifted(["int8"], BitShiftDirection="Right", BitShiftNumber="2"), tmp_path), {"u1": u})["y1"]
    assert output.tolist() == [int(one) >> 2 for one in u]
    output = run(imported(shifted(["int8"], BitShiftDirection="Left", BitShiftNumber="2"), tmp_path), {"u1": u})["y1"]
    assert output.tolist() == [np.int8((int(one) << 2) & 0xFF if (int(one) << 2) & 0x80 == 0 else
                              ((int(one) << 2) & 0xFF) - 256) for one in u]  # fmt: skip
    both = shifted(["uint8", "int8"], BitShiftNumberSource="Input port")
    output = run(imported(both, tmp_path), {"u1": [200.0] * 4, "u2": [3.0, -1.0, 0.0, -2.0]})["y1"]
    assert output.tolist() == [25, 400 % 256, 200, 800 % 256]


def behind(kind, **parameters):
    """A shift by one bit of a block's output."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block(kind, "K", ports=(0, 1), **parameters)
    drawn.block("ArithShift", "B", BitShiftNumber="1", BinPtShiftNumber="0")
    drawn.outport("y")
    drawn.chain("K", "B", "y")
    return drawn


def test_a_shift_of_an_unknown_type_is_refused(tmp_path):
    for kind, value in (("Constant", "k"), ("Constant", "1 + uint8(3)"), ("DataStoreRead", "")):
        with pytest.raises(InputError, match=r"depends on the integer type|data store A not found"):
            imported(behind(kind, Value=value), tmp_path, parameters=[{"k": 3.0}])


@pytest.mark.parametrize(
    ("path", "bits", "point", "factor"),
    [
        ("Right", "2", "0", 0.25),
        ("Left", "3", "0", 8),
        ("Bidirectional", "-1", "0", 2),
        ("Bidirectional", "2", "1", 0.5),
    ],
)
def test_a_shift_scales_a_floating_point_number(path, bits, point, factor, tmp_path):
    u = np.array([-6.625, 0.3, 5.0])
    drawn = alone("ArithShift", BitShiftDirection=path, BitShiftNumber=bits, BinPtShiftNumber=point)
    np.testing.assert_array_equal(run(imported(drawn, tmp_path), {"u1": u})["y1"], factor * u)
    assert run(imported(behind("Constant", Value="5"), tmp_path), samples=1)["y"][0] == 2.5


@pytest.mark.parametrize("mask", ["0xF1", "hex2dec('F1')", "0b11110001", "bin2dec('11110001')", "mask"])
def test_a_mask_may_be_written_in_hexadecimal_and_binary(mask, tmp_path):
    drawn = alone("x", special="Bitwise Operator", logicop="AND", UseBitMask="on", BitMask=mask)
    model = imported(drawn, tmp_path, parameters=[{"mask": 241.0}])
    assert run(model, {"u1": [255.0, 14.0, 1027.0]})["y1"].tolist() == [241, 0, 1]


def test_the_slope_of_bits_is_0(tmp_path):
    drawn = alone("Reference", special="Bitwise Operator", logicop="AND", BitMask="3")
    drawn.block("Gain", "K", Gain="k")
    drawn.wires[0].ends = [("K", "in", 1)]
    drawn.line("K", "B:1")
    model = imported(drawn, tmp_path, parameters=[{"k": 2.37}])
    exact, differences = slopes(model, {"u1": WHOLE[:4]}, "k", "y1")
    assert not exact.any()
    assert not differences.any()


@pytest.mark.parametrize(("path", "sign"), [("Right", -1), ("Bidirectional", -1), ("Left", 1)])
def test_a_floating_point_number_is_shifted_by_a_fraction_as_generated_code_does(path, sign, tmp_path):
    u, bits = np.array([-6.625, 0.3, 5.0, 7.0, 1.5]), np.array([2.5, -1.25, 0.0, 3.0, -0.5])
    drawn = alone("ArithShift", 2, BitShiftDirection=path, BitShiftNumberSource="Input port")
    output = run(imported(drawn, tmp_path), {"u1": u, "u2": bits})["y1"]
    # ldexp(u, (int32_T)floor(0.0 - s)), which rounds another way than -floor(s)
    np.testing.assert_array_equal(output, np.ldexp(u, np.floor(sign * bits).astype(int)))


@pytest.mark.parametrize("text", ["1.5", "n", "[1 0.5 2]"])
def test_a_number_of_bits_in_the_dialog_must_be_an_integer(text, tmp_path):
    drawn = alone("ArithShift", BitShiftNumber=text)
    with pytest.raises(InputError, match=r"its BitShiftNumber must be an integer, got (1\.5|0\.5)"):
        imported(drawn, tmp_path, parameters=[{"n": 1.5}])


def test_an_integer_shifted_by_a_fraction_is_remarked(tmp_path):
    drawn = shifted(["uint8", "double"], BitShiftNumberSource="Input port")
    notes = import_simulink(drawn.write(tmp_path)).report.notes
    assert any("rounds its number of bits down" in str(note) for note in notes)
