"""The parser of ESDL: trees of all kinds of declarations, all errors at once, and bounds against hostile text."""

import pytest
from hypothesis import strategies as st

from kennfeld.ascet import syntax as e
from kennfeld.ascet.lexer import tokens_of
from kennfeld.ascet.parser import parse_esdl, scan_esdl
from kennfeld.base.errors import InputError
from tests.draws import few_or_many

PLANT = """package Plant.Model;
import SystemLib.Math.MathLib;
import units.*;

/** Temperature in the cell. */
type Celsius is real -40.0 .. 120.0 delta 0.1;
type Small is native integer using uint8;
type Curve is table real -> real;
type Mode is enum { Off, On = 4, Auto };
type Row is array [3] of real;
unit kmh = km/h;
formula f_0p1 { scale = 10.0; offset = 0.0; }
sysconst integer COUNT in 1 .. 9 = 4;

data interface Signals using Impl {
	@symbol("speed")
	kmh speed = 0.0[kmh];
	representation Impl { represent speed using { datatype = uint16; }; }
}

singleton class Cell
using Impl
reads Signals.speed
writes Signals.force, Other.x {
	/** Gain <b>of</b> the cell */
	characteristic real K = 1_000.5;
	characteristic real half <- "x / 2", x = K;
	characteristic Curve C[2] = { { 0.0, 1.0 }, { 2.0, -3.0E-1 } };
	@get
	private boolean busy = true;
	real ^delta = 0.0;

	@thread
	public void calc(real in a, Small inout b) {
		real x = if (a > 0.0) then a else -a;
		if (busy && !(a <= 1.0)) { x += 1.0; } else if (b == 0x1F) x = 0.0; else { ^delta = 2.0; }
		for (i in 0 .. 2) { x = x * 2.0; }
		while (x > 10.0) { x = x - 1.0; }
		switch (b) { case 1, 2 : x = 1.0; default : x = 0.0; }
		this.step(x, a between 0.0 and 1.0);
		return;
	}
	public real step(real x, boolean y);
	public initializer Old() { K = 2.0; }
	void trigger() triggers Machine;
	statemachine Machine using Mode {
		start Off;
		state Off { entry { x = 1.0; } transition busy to On { x = 2.0; }; }
		state On { static { x = 3.0; } exit { x = 0.0; } transition true to j; junction j { transition busy to Off; } }
	}
	representation Impl { represent K using f_0p1; represent calc.a using { range = 0 .. 5; }; }
}
"""


def class_of(text):
    """The class of a text with the statements of one method."""
    return parse_esdl(text).declarations[-1]


def expression(text):
    """The tree of an expression."""
    statement = class_of(f"class C {{ void m() {{ y = {text}; }} }}").methods[0].body[0]
    assert isinstance(statement, e.Assign)
    return statement.value


def test_a_file_has_its_package_imports_and_declarations():
    file = parse_esdl(PLANT)
    assert file.package == "Plant.Model"
    assert file.imports == ("SystemLib.Math.MathLib", "units.*")
    assert [item.name for item in file.declarations] == [
        "Celsius", "Small", "Curve", "Mode", "Row", "kmh", "COUNT", "Signals", "Cell",
    ]  # fmt: skip


def test_types_keep_their_range_and_labels():
    celsius, small, curve, mode, row, *_ = (item.type for item in parse_esdl(PLANT).declarations[:5])
    assert celsius.range == e.Range(e.Unary("-", e.Number(40.0)), e.Number(120.0))
    assert small == e.ScalarType("integer", using="uint8")
    assert curve == e.TableType((e.TypeName("real"),), e.TypeName("real"))
    assert mode.labels == (("Off", None), ("On", e.Number(4.0, False)), ("Auto", None))
    assert row == e.ArrayType((e.Number(3.0, False),), e.TypeName("real"))


def test_members_of_a_class_are_grouped_by_kind():
    cell = class_of(PLANT)
    assert cell.modifiers == {"singleton"}
    assert cell.reads == ("Signals.speed",)
    assert cell.writes == ("Signals.force", "Other.x")
    assert [item.name for item in cell.elements] == ["K", "half", "C", "busy", "delta"]
    assert [item.name for item in cell.methods] == ["calc", "step", "trigger"]
    assert [item.name for item in cell.initializers] == ["Old"]
    assert cell.methods[1].body is None
    assert cell.methods[2].triggers == "Machine"


def test_elements_keep_values_formulas_and_descriptions():
    gain, half, curve, busy, _ = class_of(PLANT).elements
    assert (gain.kind, gain.value, gain.description) == ("characteristic", e.Number(1000.5), "Gain of the cell")
    assert half.formula == ("x / 2", (("x", e.Name("K")),))
    assert curve.sizes == (e.Number(2.0, False),)
    assert busy.has("get")
    assert not busy.has("set")


def test_state_machines_have_states_junctions_and_actions():
    machine = class_of(PLANT).machines[0]
    off, on = machine.states
    assert (machine.start, machine.labels) == ("Off", "Mode")
    assert off.transitions == (e.Transition(e.Name("busy"), "On", (e.Assign(e.Name("x"), e.Number(2.0)),)),)
    assert [state.is_junction for state in on.states] == [True]
    assert on.exit
    assert not on.entry


def test_multiplication_binds_tighter_than_comparison_and_logic():
    tree = expression("a + b * c < d && !e || f")
    product = e.Binary("+", e.Name("a"), e.Binary("*", e.Name("b"), e.Name("c")))
    conjunction = e.Binary("&&", e.Binary("<", product, e.Name("d")), e.Unary("!", e.Name("e")))
    assert tree == e.Binary("||", conjunction, e.Name("f"))


def test_a_number_keeps_its_kind_and_unit():
    assert expression("50.0[kmh]") == e.Number(50.0, True, "kmh")
    assert expression("0xFF") == e.Number(255.0, False)
    assert expression("1_000") == e.Number(1000.0, False)


def test_a_conditional_extends_as_far_as_possible():
    tree = expression("if a then 1.0 else b + 2.0")
    assert tree == e.Conditional(e.Name("a"), e.Number(1.0), e.Binary("+", e.Name("b"), e.Number(2.0)))


def test_a_documentation_comment_belongs_to_the_next_declaration():
    tokens = tokens_of("/** one */ a /* two */ b // three\nc")
    assert [(token.text, token.description) for token in tokens] == [("a", "one"), ("b", ""), ("c", ""), ("", "")]


def test_all_errors_are_reported_with_line_and_column():
    text = (
        "class A {\n real x = ;\n void m() {\n  y = 1 +;\n  z = 2;\n  u = );\n }\n real v;\n}\nclass { }\nclass B { }\n"
    )
    parsed = scan_esdl(text, "a.esdl")
    assert [(f.location.line, f.location.column) for f in parsed.findings] == [(2, 11), (4, 10), (6, 7), (10, 7)]
    first, last = parsed.file.declarations
    assert [item.name for item in first.elements] == ["v"]
    assert first.methods[0].body == (e.Assign(e.Name("z"), e.Number(2.0, False)),)
    assert last.name == "B"


def test_an_error_names_the_file_and_the_expected_token():
    with pytest.raises(InputError, match=r"a\.esdl line 1, column 20: expected an expression, got ';'"):
        parse_esdl("class A { real x = ; }", "a.esdl")


@pytest.mark.parametrize("number", ["1e999", "0x_", "9" * 400])
def test_a_number_that_is_not_finite_is_an_error(number):
    with pytest.raises(InputError, match="invalid number"):
        parse_esdl(f"class A {{ real x = {number}; }}")


def test_an_open_comment_is_named():
    with pytest.raises(InputError, match=r"\*/ is missing behind /\*"):
        parse_esdl("class A { /* real x; }")


@pytest.mark.parametrize(
    "text",
    [
        "class A { void m() { x = " + "(" * 3_000 + "1; } }",
        "class A { void m() { " + "if (a) { " * 3_000 + "} }",
        "class A { void m() { " + "if (a) x = 1; else " * 1_200 + "; } }",
        "class A { void m() { x = 1" + " + 1" * 3_000 + "; } }",
        "class A { void m() { x = " + "-" * 3_000 + "1; } }",
        "class A { void m() { x = a" + ".b" * 3_000 + "; } }",
        "type a is " + "array [2] of " * 3_000 + "real;",
        "class A { statemachine M { " + "state s { " * 3_000,
        "/*" * 10_000,
        '\\"' * 10_000,
    ],
)
def test_hostile_text_ends_in_an_error(text):
    with pytest.raises(InputError):
        parse_esdl(text)


_WORDS = [*'{}()[];,.=<>+-*/!&|^@"\n ', "class ", "real ", "if", "x", "1", "/*", "*/", "state", "->"]


@few_or_many(st.lists(st.sampled_from(_WORDS)).map("".join), few=20, many=100)
def test_any_text_gives_a_tree_or_findings(text):
    parsed = scan_esdl(text)
    assert parsed.file.name == "text"
    assert all(finding.location.line >= 1 for finding in parsed.findings)


@few_or_many(st.integers(0, len(PLANT)), st.integers(0, 30), few=20, many=100)
def test_a_file_with_a_gap_gives_a_tree_or_findings(start, length):
    parsed = scan_esdl(PLANT[:start] + PLANT[start + length :])
    assert all(finding.location.column > 0 for finding in parsed.findings)
