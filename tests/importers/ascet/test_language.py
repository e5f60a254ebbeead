"""What the parts of ESDL mean, in small classes of one method."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph.events import events
from kennfeld.importers.ascet.importing import esdl, import_esdl
from kennfeld.models.formula import formula, to_text
from tests.importers.ascet.esdl_projects import MACHINE, class_model, run, write_project


def outputs(folder, text, columns=None, samples=None, **options):
    """The nodes of the class in a text, over the samples."""
    return run(class_model(folder, text, **options), columns, samples=samples)


def method(body, result="real", arguments="real in x", members=""):
    return f"class C {{ {members} public {result} calc({arguments}) {{ {body} }} }}"


def test_integers_are_divided_towards_zero(tmp_path):
    text = method("return real((i / 2) * 100 + i % 3);", arguments="integer in i")
    assert outputs(tmp_path, text, {"i": [7, -7, 0]})["calc"].tolist() == [301.0, -301.0, 0.0]


def test_a_quotient_of_integers_converted_at_once_is_not_cut_off(tmp_path):
    text = method("return real(i / 4);", arguments="integer in i")
    assert outputs(tmp_path, text, {"i": [7, -7, 0]})["calc"].tolist() == [1.75, -1.75, 0.0]


def test_division_by_zero_gives_the_numerator(tmp_path):
    assert outputs(tmp_path, method("return 3.0 / x;"), {"x": [2.0, 0.0]})["calc"].tolist() == [1.5, 3.0]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [("i / (1 / N)", 7.0), ("real(i / (1 / N))", 7.0), ("i % (1 / N)", 0.0), ("i % 0", 0.0), ("i / 0", 7.0)],
)
def test_a_divisor_of_integers_is_tested_for_zero(tmp_path, expression, expected):
    text = method(f"return real({expression});", arguments="integer in i", members="characteristic integer N = 3;")
    assert outputs(tmp_path, text, {"i": [7]})["calc"].tolist() == [expected]


def test_integers_are_limited_to_the_range_of_their_type(tmp_path):
    text = "type Small is integer 0 .. 10;" + method("n = n + 4; return real(n);", arguments="", members="Small n = 0;")
    assert outputs(tmp_path, text, samples=4)["calc"].tolist() == [4.0, 8.0, 10.0, 10.0]


def test_a_conversion_to_an_integer_is_cut_off_and_limited(tmp_path):
    text = "type Byte is integer using uint8;" + method("return real(Byte(x));")
    assert outputs(tmp_path, text, {"x": [2.9, -3.0, 300.0]})["calc"].tolist() == [2.0, 0.0, 255.0]


def test_bits_of_integers(tmp_path):
    text = "type Word is integer 0 .. 65535;" + method(
        "return real((a & b) * 1000000 + (a | b) * 1000 + (a ^ b)) + real(a << 2) / 1000.0 + real(a >> 1) / 1000000.0;",
        arguments="Word in a, Word in b",
    )
    value = outputs(tmp_path, text, {"a": [12.0], "b": [10.0]})["calc"]
    assert value.tolist() == pytest.approx([8_014_006.048006])


def test_a_loop_runs_over_ranges_types_and_arrays(tmp_path):
    text = """type Index is integer 1 .. 3; type Row is array [Index] of real;
    class C { Row v = { 1.0, 2.0, 4.0 };
      public real calc(real in x) {
        real sum = 0.0;
        for (i in 0 .. 2) { sum += x; }
        for (i in Index) { sum += v[i] * 10.0; }
        for (i in v.indexRange()) { sum += real(i) * 1000.0; }
        return sum + real(v.length()) * 100000.0;
      } }"""
    assert outputs(tmp_path, text, {"x": [0.5]})["calc"].tolist() == [306_071.5]


def test_a_while_loop_ends_by_its_condition(tmp_path):
    text = method("integer n = 0; while (n < 4) { n += 1; if (n == 3) { break; } } return x * real(n);")
    assert outputs(tmp_path, text, {"x": [2.0]})["calc"].tolist() == [6.0]


def test_an_index_out_of_range_takes_the_nearest_element(tmp_path):
    text = method("return v[i];", arguments="integer in i", members="real v[3] = { 1.0, 2.0, 4.0 };")
    assert outputs(tmp_path, text, {"i": [-1, 1, 5]})["calc"].tolist() == [1.0, 2.0, 4.0]


def test_matrices_are_read_and_written_by_row_and_column(tmp_path):
    text = method(
        "m[1][i] = x; return m[0][2] * 100.0 + m[1][0] * 10.0 + m[1][2];",
        arguments="real in x, integer in i",
        members="real m[2][3] = { { 1.0, 2.0, 3.0 }, { 4.0, 5.0, 6.0 } };",
    )
    nodes = outputs(tmp_path, text, {"x": [9.0, 8.0], "i": [0, 2]})
    assert nodes["calc"].tolist() == [396.0, 398.0]
    assert nodes["m[1][0]"].tolist() == [9.0, 9.0]


def test_structs_and_arrays_of_structs_are_copied_and_returned(tmp_path):
    text = """type Pair is struct { real a; real b; }; type Pairs is array [2] of Pair;
    class C {
      Pairs all = { { 1.0, 2.0 }, { 3.0, 4.0 } };
      Pair last;
      Pair swapped(Pair in p) { Pair q; q.a = p.b; q.b = p.a; return q; }
      public real calc(real in x) {
        all[0].a = x;
        last = swapped(all[0]);
        all[1] = last;
        all[0] = { 7.0, 8.0 };
        return all[1].a * 10.0 + all[1].b + all[0].b * 100.0;
      } }"""
    nodes = outputs(tmp_path, text, {"x": [5.0]})
    assert nodes["calc"].tolist() == [825.0]
    assert nodes["last.a"].tolist() == [2.0]


def test_a_method_changes_its_inout_arguments(tmp_path):
    text = """class C { real total = 0.0;
      real add(real inout sum, real in x) { sum = sum + x; return sum * 2.0; }
      public real calc(real in x) { real y; y = add(total, x); return y + total; } }"""
    assert outputs(tmp_path, text, {"x": [1.0, 2.0]})["calc"].tolist() == [3.0, 9.0]


def test_only_one_side_of_a_conditional_is_called(tmp_path):
    text = """class C { real n = 0.0;
      real count() { n = n + 1.0; return n; }
      public real calc(boolean in on) { real y = if on then count() else -1.0; return y; } }"""
    assert outputs(tmp_path, text, {"on": [1, 0, 0, 1]})["calc"].tolist() == [1.0, -1.0, -1.0, 2.0]


def test_the_second_operand_of_and_is_called_only_if_needed(tmp_path):
    text = """class C { real n = 0.0;
      boolean count() { n = n + 1.0; return true; }
      public real calc(boolean in on) { boolean y = on && count(); return if y then n else n * 10.0; } }"""
    assert outputs(tmp_path, text, {"on": [1, 0, 1]})["calc"].tolist() == [1.0, 10.0, 2.0]


COUNTER = "real n = 0.0; integer at = 0; real v[3]; real count() { n = n + 1.0; return n; } "
COUNTER += "integer next() { at = at + 1; return at - 1; }"


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("boolean b = count() between 2.0 and 3.0; return if b then n else -n;", [-1.0, 2.0, 3.0, -4.0]),
        ("boolean b = on && (count() between 2.0 and 3.0); return if b then n else -n;", [-1.0, -1.0, 2.0, 3.0]),
        ("return (switch next() case 0, 1 : 10.0 case 2 : 20.0 default : 30.0) + real(at);", [11.0, 12.0, 23.0, 34.0]),
        ("v[next()] += 2.0; return v[0] + v[1] * 10.0 + real(at) * 100.0;", [102.0, 222.0, 322.0, 422.0]),
    ],
)
def test_an_operand_that_calls_a_method_is_evaluated_once(tmp_path, body, expected):
    text = method(body, arguments="boolean in on", members=COUNTER)
    assert outputs(tmp_path, text, {"on": [1, 0, 1, 1]})["calc"].tolist() == expected


def test_a_subject_within_a_condition_that_calls_a_method_is_refused(tmp_path):
    text = method("return if on then (switch next() case 0 : 1.0 default : 2.0) else 0.0;",
                  arguments="boolean in on", members=COUNTER)  # fmt: skip
    with pytest.raises(InputError, match=r"is used several times within a condition. Store it in a variable"):
        class_model(tmp_path, text)


def test_a_switch_runs_one_case(tmp_path):
    text = """type Mode is enum { Off, Slow = 4, Fast };
    class C { public real calc(Mode in mode, real in x) {
      real y = 0.0;
      switch (mode) { case Mode.Off : { y = 1.0; } case Slow, Mode.Fast : y = x; break; default : y = -1.0; }
      return y; } }"""
    assert outputs(tmp_path, text, {"mode": [0, 4, 5, 7], "x": [9.0] * 4})["calc"].tolist() == [1.0, 9.0, 9.0, -1.0]


def test_a_break_in_the_block_of_a_case_ends_the_case_and_not_the_loop_around_it(tmp_path):
    case = "switch (i) { case 1 : { y = y + x; break; } default : y = y + 10.0; }"
    text = method(f"real y = 0.0; for (i in 0 .. 3) {{ {case} }} return y;")
    assert outputs(tmp_path, text, {"x": [1.0]})["calc"].tolist() == [31.0]


def test_a_break_under_a_condition_skips_the_rest_of_its_case(tmp_path):
    case = """switch (i) {
      case 1 : {
        y = 1.0;
        if (x > 3.0) { y = 2.0; break; } else if (x > 2.0) { if (x > 2.5) { break; } y = 5.0; }
        y = y + x;
      }
      case 2 : if (x < 1.0) { break; } y = 7.0; break; y = 100.0;
      default : { if (x > 0.0) { y = -x; } else { break; } y = y - 1.0; } }"""
    text = method(f"real y = 0.0; {case} return y;", arguments="real in x, integer in i")
    x = np.array([4.0, 2.7, 2.2, 0.5, 0.5, 3.0, 2.0, -1.0])
    i = np.array([1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0])
    assert outputs(tmp_path, text, {"x": x, "i": i})["calc"].tolist() == [2.0, 1.0, 7.2, 1.5, 0.0, 7.0, -3.0, 0.0]
    declared = "switch (i) { case 1 : if (x > 3.0) { real z = x; if (z > 4.0) { break; } y = z; } y = y + x; }"
    text = method(f"real y = 0.0; {declared} return y;", arguments="real in x, integer in i")
    with pytest.raises(InputError, match="a break beside the declaration of a variable"):
        class_model(tmp_path, text)


def test_a_loop_without_a_known_end_is_followed_with_a_remark(tmp_path):
    text = method("real y = x; while (y > 1.0) { y = y - 1.0; } return y;", arguments="real in x")
    model = class_model(tmp_path, text)
    (remark,) = [str(remark) for remark in model.remarks if "followed for" in str(remark)]
    assert "the end of a loop in line" in remark
    assert outputs(tmp_path, text, {"x": [0.5, 7.25, 900.0, 2e6]})["calc"].tolist() == pytest.approx(
        [0.5, 0.25, 1.0, np.nan], nan_ok=True
    )


def test_a_return_within_a_branch_ends_the_method(tmp_path):
    text = method(
        "if (x > 1.0) { return 1.0; } if (x < 0.0) { n = n + 1.0; return n; } return x;", members="real n = 10.0;"
    )
    assert outputs(tmp_path, text, {"x": [2.0, -1.0, 0.5, -3.0]})["calc"].tolist() == [1.0, 11.0, 0.5, 12.0]


def test_a_lag_behind_a_limit_does_not_jump_depending_on_them(tmp_path):
    """The branches meet at the limit; the first sample alone decides where the state is set."""
    members = """@dT real dT = 0.0; characteristic real tau = 1.0; characteristic real limit = 2.0;
        real z = 0.0; boolean first = true;"""
    body = """
        if (first) { z = x; first = false; } else { z = z + (x - z) * dT / (tau + dT); }
        if (z > limit) { return limit; }
        return z;"""
    graph = class_model(tmp_path, method(body, members=members)).graph
    assert events(graph, ["tau", "limit"]) == ()
    jumping = class_model(tmp_path, method(body.replace("return limit", "return 5.0"), members=members)).graph
    assert [event.word for event in events(jumping, ["tau", "limit"])] == [">"]


def test_group_tables_share_an_axis_that_is_searched(tmp_path):
    text = """type Speeds is axis real; type Shared is group table Speeds -> real;
    class C {
      characteristic Speeds n[3] = { 0.0, 10.0, 20.0 };
      characteristic Shared low[n] = { 0.0, 1.0, 3.0 };
      characteristic Shared high[n] = { 5.0, 6.0, 6.0 };
      public real calc(real in x) { n.search(x); return low.interpolate() + high.interpolate() * 100.0; } }"""
    model = class_model(tmp_path, text)
    assert [axis.name for axis in model.values.axes] == ["n"]
    assert run(model, {"x": [5.0, 15.0, 99.0]})["calc"].tolist() == [550.5, 602.0, 603.0]


def test_a_group_map_shares_two_distributions(tmp_path):
    text = """type Speeds is distribution real; type Loads is distribution real;
    type Map is group table Speeds, Loads -> real;
    class C {
      characteristic Speeds n[2] = { 0.0, 10.0 }; characteristic Loads p[3] = { 0.0, 1.0, 2.0 };
      characteristic Map low[n][p] = { { 0.0, 1.0, 4.0 }, { 10.0, 11.0, 14.0 } };
      characteristic Map high[n][p] = { { 1.0, 1.0, 1.0 }, { 2.0, 2.0, 2.0 } };
      public real calc(real in x, real in y) {
        n.search(x); p.search(y);
        return low.interpolate() + high.interpolate() * 100.0 + low.getAt(0.0, 2.0) * 1000.0; } }"""
    nodes = outputs(tmp_path, text, {"x": [5.0, 99.0, -1.0], "y": [1.5, 0.5, 9.0]})
    assert nodes["calc"].tolist() == [4000.0 + 150.0 + 7.5, 4000.0 + 200.0 + 10.5, 4000.0 + 100.0 + 4.0]


def test_a_table_is_interpolated_where_it_was_searched_last(tmp_path):
    text = "type Map is table real, real -> real;" + method(
        "if (on) { m.search(x, 2.0 * x); } return m.interpolate();",
        arguments="real in x, boolean in on",
        members="characteristic Map m[2][2] = { { 1.0, 3.0 }, { 0.0, 4.0 }, { { 1.0, 5.0 }, { 3.0, 9.0 } } };",
    )
    nodes = outputs(tmp_path, text, {"x": [0.5, 2.0, 3.0, 9.0], "on": [0, 1, 0, 1]})
    assert nodes["calc"].tolist() == [1.0, 7.0, 7.0, 9.0]


def test_a_matrix_by_its_keyword_is_an_array_of_two_dimensions(tmp_path):
    text = "type M is matrix [2][3] of real;" + method(
        "real s = 0.0; for (i in 0 .. 1) { for (k in 0 .. 2) { a[i][k] = b[i][k] * x; s += a[i][k]; } } return s;",
        members="M a; const M b = { { 1.0, 2.0, 3.0 }, { 4.0, 5.0, 6.0 } };",
    )
    assert outputs(tmp_path, text, {"x": [2.0]})["calc"].tolist() == [42.0]


def test_a_dependent_characteristic_may_depend_on_others_of_tables_and_arrays(tmp_path):
    members = """characteristic real v[2] = { 2.0, 3.0 }; characteristic real a <- "x * y", x = v[0], y = v[1];
        characteristic real b <- "if x > 5.0 then x / 2.0 else 0.0", x = a;"""
    assert outputs(tmp_path, method("return a * 10.0 + b * x;", members=members), {"x": [1.0]})["calc"].tolist() == [
        63.0
    ]


def test_a_fixed_table_has_breakpoints_at_equal_distance(tmp_path):
    text = "type Even is fixed table real -> real;" + method(
        "return t.getAt(x);", members="characteristic Even t[3] = { { 1.0, 2.0 }, { 0.0, 4.0, 6.0 } };"
    )
    assert outputs(tmp_path, text, {"x": [0.0, 2.0, 4.0, 9.0]})["calc"].tolist() == [0.0, 2.0, 5.0, 6.0]


def test_the_delta_time_is_the_step(tmp_path):
    text = "import Lib.Time.DeltaTime;" + method("return x * DeltaTime.deltaT;")
    assert outputs(tmp_path, text, {"x": [3.0]}, step=0.25)["calc"].tolist() == [0.75]


def test_a_state_machine_runs_its_actions_in_order(tmp_path):
    columns = {"go": [0, 1, 1, 1, 1, 1, 0, 1, 1], "level": [0, 0, 0, 1, 3, 0, 0, 0, 6]}
    nodes = outputs(tmp_path, MACHINE, columns, methods=["step", "now"])
    assert nodes["now"].tolist() == [0, 1, 1, 1, 3, 3, 0, 1, 0]
    first = [0, 236, 2364, 23644]
    assert nodes["trace"][:4].tolist() == first
    # into Slow: exit of Ready, entry of Slow, static of Busy; then the static actions; out: exit, entry of Idle
    assert nodes["trace"][4:7].tolist() == [23644784, 2364478494, 236447849451]


def test_parameters_of_loops_are_constants_with_a_remark(tmp_path):
    text = method(
        "for (i in 1 .. N) { x2 = x2 + x; } return x2;", members="characteristic integer N = 3; real x2 = 0.0;"
    )
    model = class_model(tmp_path, text)
    assert run(model, {"x": [1.0]})["calc"].tolist() == [3.0]
    assert any("constant" in str(remark) for remark in model.remarks)


def test_names_of_calibration_files_are_preferred(tmp_path):
    text = method("return x * K;", members="characteristic real K = 2.0;")
    model = class_model(tmp_path, text, parameters=ParameterSet([Scalar("Own.C.K", 5.0)]))
    assert list(model.values) == ["Own.C.K"]


def test_every_unsupported_part_is_reported_with_its_line(tmp_path):
    text = """class Device { public extern real read(); }
class C {
	Device device;
	public real calc(real in x) {
		real y = device.read();
		y = unknown + 1.0;
		y.z = 3.0;
		return y;
	}
}
"""
    write_project(tmp_path, {"Own/Own/Own.esdl": f"package Own;\n{text}"})
    result = import_esdl(tmp_path / "Own/Own/Own.esdl", "C")
    assert result.model is None
    assert [finding.location.line for finding in result.report.findings[:3]] == [6, 7, 8]
    assert "Device.read is implemented in C" in str(result.report.findings[0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("class C { void calc() { calc(); } }", "calls itself"),
        ("class C { characteristic real K = 1.0; public void calc() { K = 2.0; } }", "cannot be assigned"),
        ("type A is A; class C { A a; public real calc() { return a; } }", "unknown name a"),
        ("class C { public real calc(real in x) { if (x > 0.0) { return 1.0; } } }", "does not assign"),
    ],
)
def test_programs_without_a_graph_end_in_findings(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        class_model(tmp_path, text)


def test_elements_that_are_not_used_only_give_a_warning(tmp_path):
    text = "class C { C itself; Unknown other; public real calc(real in x) { return x + 1.0; } }"
    model = class_model(tmp_path, text)
    warnings = [str(remark) for remark in model.remarks if remark.severity == "warning"]
    assert any("too many instances" in text for text in warnings)
    assert any("unknown type Unknown" in text for text in warnings)


def test_a_class_or_method_that_is_not_there_is_named(tmp_path):
    text = "class C { public void one() { } public void two() { } }"
    write_project(tmp_path, {"Own/Own/Own.esdl": f"package Own;\n{text}"})
    path = tmp_path / "Own/Own/Own.esdl"
    with pytest.raises(InputError, match="unknown class D"):
        esdl(path, "D")
    with pytest.raises(InputError, match=r"unknown method tow.*Did you mean two"):
        esdl(path, methods=["tow"])


def test_formula_text_of_a_class_gives_the_same_graph(tmp_path):
    model = class_model(tmp_path, MACHINE, methods=["step", "now"])
    again = formula(to_text(model.graph, model.step), parameters=model.values)
    columns = {"go": [0, 1, 1, 0], "level": [0, 0, 3, 0]}
    np.testing.assert_array_equal(run(again, columns)["now"], run(model, columns)["now"])


def _doubled(form, count):
    return "".join(form.format(i, i - 1) for i in range(1, count))


@pytest.mark.parametrize(
    "text",
    [
        "type A0 is real; "
        + _doubled("type A{0} is struct {{ A{1} a; A{1} b; }}; ", 40)
        + "class C { A39 z; public real calc(real in x) { return z.a.a.a + x; } }",
        "class A0 { real m; } "
        + _doubled("class A{0} {{ A{1} a; A{1} b; A{1} c; }} ", 14)
        + "class C { A13 z; public real calc(real in x) { return z.a.a.a.m + x; } }",
        pytest.param(
            "class C { real f0(real in x) { return x; } "
            + _doubled("real f{0}(real in x) {{ return f{1}(x) + f{1}(x); }} ", 40)
            + "public real calc(real in x) { return f39(x); } }",
            marks=pytest.mark.slow,
        ),
        "type S is enum { A, B }; class C { @get real y; public void calc() triggers M; statemachine M using S { "
        "start A; state A { transition true to j0; } state B { } "
        + "".join(
            f"junction j{i} {{ transition y > 0.0 to j{i + 1}; transition true to j{i + 1}; }} " for i in range(18)
        )
        + "junction j18 { transition true to B; } } }",
        "class C { public real calc(real in x) { for (i in 0 .. 1000000000) { x = x + 1.0; } return x; } }",
        "class C { real v[999999999]; public real calc(real in x) { return v[0]; } }",
    ],
)
def test_programs_that_grow_without_bound_end_in_findings(tmp_path, text):
    with pytest.raises(InputError):
        class_model(tmp_path, text, class_name="C")


def test_dependent_characteristics_are_calculated_once(tmp_path):
    chain = _doubled('characteristic real a{0} <- "x + x", x = a{1}; ', 40)
    text = method("return a39 * x;", members=f"characteristic real a0 = 1.5; {chain}")
    assert outputs(tmp_path, text, {"x": [1.0]})["calc"].tolist() == [1.5 * 2.0**39]


def test_a_dependent_characteristic_of_itself_is_an_error(tmp_path):
    members = 'characteristic real a <- "x", x = b; characteristic real b <- "x", x = a;'
    with pytest.raises(InputError, match="depends on itself"):
        class_model(tmp_path, method("return a * x;", members=members))


@pytest.mark.parametrize(
    ("jump", "expected"),
    [("continue", [200.0 + 10.0, 200.0]), ("break", [200.0 + 10.0, 200.0]), ("", [200.0 + 10.0, 200.0 + 10 * 11.0])],
)
@pytest.mark.parametrize("tested", ["do", "while"])
def test_a_jump_in_a_loop_within_a_loop_is_one_of_the_inner_one(tmp_path, jump, expected, tested):
    skip = f"if (x > 10.0) {{ {jump}; }}" if jump else ""
    inner = f"{{ n = n + 1; {skip} s = s + x; }}"
    loop = f"do {inner} while (n < 5);" if tested == "do" else f"while (n < 5) {inner}"
    text = method(f"real s = 0.0; for (i in 0 .. 1) {{ integer n = 0; {loop} s = s + 100.0; }} return s;")
    assert outputs(tmp_path, text, {"x": [1.0, 11.0]})["calc"].tolist() == expected


def test_a_loop_that_tests_last_is_left_in_its_first_pass(tmp_path):
    text = method(
        "real s = 0.0; integer n = 0; do { s = s + x; n = n + 1; if (s > 10.0) { break; } } while (n < 5); return s;"
    )
    assert outputs(tmp_path, text, {"x": [1.0, 4.0, 11.0]})["calc"].tolist() == [5.0, 12.0, 11.0]
