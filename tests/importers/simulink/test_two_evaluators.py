"""Functions that scripts compute as numbers and that code makes a graph of give the same, for the same constants.

Both sides get an even choice of all pairs and triples of arguments, and of single ones. Slow tests try all single ones
and more of the others for the functions that both sides have rules of their own for. What differs on purpose is listed,
with the reason.
"""

import itertools

import numpy as np
import pytest

from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab import values as v
from kennfeld.matlab.errors import Budget, MatlabError
from kennfeld.matlab.evaluator import NumericEvaluator, evaluate
from kennfeld.matlab.functions import NUMERIC_FUNCTIONS
from kennfeld.matlab.script_runner import run_script
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.library import numeric_rules
from kennfeld.models.imperative.library.function_registry import SYMBOLIC_FUNCTIONS, matlab_word
from kennfeld.models.imperative.statement_interpreter import StatementInterpreter
from kennfeld.models.imperative.symbolic_values import (
    LogicalNodes,
    String,
    as_array,
    constants,
    force,
    integers,
)
from kennfeld.program import tree as m
from tests.importers.simulink.simulink_code import U, V, body, outputs
from tests.importers.simulink.simulink_runs import alone, imported, run

SHARED = sorted(set(NUMERIC_FUNCTIONS) & set(SYMBOLIC_FUNCTIONS))
# functions that code does not hand to the functions of numbers, but has rules of its own for
TWICE = [name for name in SHARED if SYMBOLIC_FUNCTIONS[name].rule.__module__ != numeric_rules.__name__]
TEXTS = (
    "1", "-2.5", "3", "NaN", "Inf", "0", "[1 2 3]", "[3 -1 2.5]", "[4;0;-6]", "[1 2;3 4]", "[2 -1;0 5;7 1]", "[]",
    "zeros(1,0)", "zeros(0,3)", "reshape([1 3 2 4 2 1 3 1],2,2,2)", "[1 NaN 3]", "true", "[true false true]",
    "int8(5)", "int8(-7)", "uint8([200 0 3])", "'abc'", "''", "'all'", '"abc"', "{1,2}", "{'a','b'}", "{}",
    "struct('a',1,'b',[1 2])",
)  # fmt: skip
GIVEN = {text: evaluate(text) for text in TEXTS}
THREE = ("1", "3", "[1 2 3]", "[1 2;3 4]", "[]", "reshape([1 3 2 4 2 1 3 1],2,2,2)", "'all'", "-2.5")
# one of so many arguments, pairs and triples is tried; the last two are no multiples of the number of arguments
FEW, MANY = (2, 97, 101), (1, 7, 11)

OF_BITS = {"bitand", "bitor", "bitxor", "bitshift", "bitcmp", "bitget", "bitset"}
CASTS = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
MISSING = "in a graph NaN is a missing value, which an extreme passes on; a script passes over it"
INTENDED = {
    **dict.fromkeys(CASTS, "in a graph values stay physical: casts neither round nor saturate"),
    **dict.fromkeys(("min", "max", "bounds"), MISSING),
    "hypot": "in a graph NaN is a missing value, also beside infinity",
    "interp1": "in a graph a NaN of the table reaches the lines to its neighbours, their ends included",
}


def is_missing(value):
    return isinstance(value, np.ndarray) and value.dtype.kind == "f" and bool(np.isnan(value).any())


def is_intended(name, arguments):
    """Return True if the function has a documented reason for the difference; casts are compared with `double`."""
    return name in INTENDED and name not in CASTS and any(map(is_missing, arguments))


def as_double(value):
    return value.astype(float) if isinstance(value, np.ndarray) and value.dtype.kind in "iu" else value


def held(builder, value):
    """A value of scripts as one of code."""
    if isinstance(value, v.MatlabCell):
        return v.MatlabCell.of((held(builder, one) for one in value.contents), value.values.shape)
    if isinstance(value, v.MatlabStruct):
        return v.MatlabStruct.of({key: held(builder, one) for key, one in value.fields.items()})
    if value.dtype.kind == "U":
        return "".join(value.ravel().tolist())
    if value.dtype.kind == "O":
        return String(value.flat[0])
    nodes = constants(builder, value if value.dtype == bool else value.astype(float))
    return integers(nodes, matlab_word(value.dtype.name)) if value.dtype.kind in "iu" else nodes


def shown(context, one):
    """A value of code as one of scripts."""
    one = force(one)
    if isinstance(one, v.MatlabCell):
        return v.MatlabCell.of((shown(context, cell) for cell in one.contents), one.values.shape)
    if isinstance(one, v.MatlabStruct):
        return v.MatlabStruct.of({key: shown(context, inner) for key, inner in one.fields.items()})
    if isinstance(one, str):
        return v.strings([one]) if isinstance(one, String) else v.characters(one)
    numbers = context.numbers(np.asarray(as_array(one)), "it")
    return numbers.astype(bool) if isinstance(one, LogicalNodes) else numbers


def same(one, other):
    if isinstance(one, v.MatlabCell) and isinstance(other, v.MatlabCell):
        pairs = zip(one.values.ravel(), other.values.ravel(), strict=True)
        return one.values.shape == other.values.shape and all(same(*pair) for pair in pairs)
    if isinstance(one, v.MatlabStruct) and isinstance(other, v.MatlabStruct):
        return one.names == other.names and all(same(one.fields[key], other.fields[key]) for key in one.names)
    if not (isinstance(one, np.ndarray) and isinstance(other, np.ndarray)) or one.shape != other.shape:
        return False
    kinds = ["f" if array.dtype.kind in "iu" else array.dtype.kind for array in (one, other)]
    if kinds[0] != kinds[1] or kinds[0] in "UO":
        return kinds[0] == kinds[1] and one.tolist() == other.tolist()
    numbers = (array.astype(float) for array in (one, other))
    return np.allclose(*numbers, rtol=1e-9, atol=1e-12, equal_nan=True)


def in_scripts(name, arguments, wanted):
    """What a script gets; None where it is refused."""
    try:
        return NumericEvaluator({}, {}, Budget(), "").call(name, arguments, wanted, m.TextPosition())
    except MatlabError:
        return None


def in_code(name, arguments, wanted):
    """What code gets; None where it is refused."""
    builder = GraphBuilder()
    context = EvaluationContext(builder)
    try:
        results = SYMBOLIC_FUNCTIONS[name].results(
            StatementInterpreter(context).expressions, [held(builder, one) for one in arguments], wanted
        )
        return [shown(context, one) for one in results[: max(wanted, 1)]]
    except ProgramError:
        return None


def calls(name, tried):
    """The arguments of the calls that are tried, as texts, and how many results are wanted."""
    singles, pairs, triples = tried
    counts = range(
        max(NUMERIC_FUNCTIONS[name].least, SYMBOLIC_FUNCTIONS[name].least),
        min(NUMERIC_FUNCTIONS[name].most, SYMBOLIC_FUNCTIONS[name].most) + 1,
    )
    for count in counts:
        if count < 2:
            yield from itertools.product(
                itertools.product(TEXTS[SHARED.index(name) % singles :: singles], repeat=count), (1, 2)
            )
        elif count < 4:
            every, pool = (pairs, TEXTS) if count == 2 else (triples, THREE)
            chosen = itertools.islice(itertools.product(pool, repeat=count), SHARED.index(name) % every, None, every)
            yield from ((texts, 1) for texts in chosen)


def differences(name, tried):
    """The calls of a function that differ, with what each side gives and whether that is intended."""
    for texts, wanted in calls(name, tried):
        arguments = [GIVEN[text] for text in texts]
        with np.errstate(all="ignore"):
            plain = arguments if name in OF_BITS else list(map(as_double, arguments))
            number = in_scripts("double" if name in CASTS else name, plain, wanted)
            graph = in_code(name, arguments, wanted)
        if number is None or graph is None:
            continue
        pairs = zip(number, graph, strict=False)
        if not number or not graph or not all(same(*pair) for pair in pairs):
            yield f"{name}({', '.join(texts)})", number, graph, is_intended(name, arguments)


@pytest.mark.parametrize("name", SHARED)
def test_scripts_and_code_agree(name):
    assert [difference[:3] for difference in differences(name, FEW) if not difference[3]] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", TWICE)
def test_scripts_and_code_agree_in_all_that_is_written_twice(name):
    assert [difference[:3] for difference in differences(name, MANY) if not difference[3]] == []


@pytest.mark.parametrize("name", ["max", "interp1", "hypot", "int8", "uint16"])
def test_what_differs_on_purpose_still_does(name):
    assert name in INTENDED
    extra = {
        "max": ("NaN", "1"),
        "hypot": ("NaN", "Inf"),
        "interp1": ("[1 NaN 3]", "1"),
        "int8": ("-2.5",),
        "uint16": ("-2.5",),
    }[name]
    arguments = [GIVEN[text] for text in extra]
    assert not same(in_scripts(name, arguments, 1)[0], in_code(name, arguments, 1)[0])


def test_code_passes_values_through_structs_and_cells(tmp_path):
    code = (
        "c = {u, [v 2]}; c{end+1} = 3; s = struct('a', c(1), 'b', 5); s = rmfield(s, 'b'); [p, q] = deal(u, v);\n"
        "d = cellfun(@(x) 2*sum(x), c); m = num2cell([u v]); e = cell2struct({p; q}, {'p'; 'q'});\n"
        "y = d(2) + d(3) + s.a + m{2} + e.q + sum(structfun(@(x) x, e)) + feval(@max, arrayfun(@(x) x^2, [u v]));"
    )
    expected = [2 * (v + 2) + 6 + u + v + v + u + v + max(u * u, v * v) for u, v in zip(U, V, strict=True)]
    np.testing.assert_allclose(outputs(body(code), tmp_path), expected, rtol=1e-12)


def test_code_computes_what_only_scripts_had_a_rule_for(tmp_path):
    code = "[a, b] = bounds([u v 1]); y = a + 10*b + rms([u; v]) + 100*mean([u v; 1 2], 'all') + 1000*isinf(u);"
    expected = [
        min(u, v, 1) + 10 * max(u, v, 1) + np.sqrt((u * u + v * v) / 2) + 25 * (u + v + 3)
        for u, v in zip(U, V, strict=True)
    ]
    np.testing.assert_allclose(outputs(body(code), tmp_path), expected, rtol=1e-12)


def test_a_script_deletes_all_rows_and_puts_numbers_into_strings():
    assert run_script("u = [1 2 3]; u(:,:) = [];").variables["u"].shape == (0, 3)
    assert run_script('q = "a"; q(2) = 5;').variables["q"].tolist() == [["a", "5"]]


# decided by the documentation of MATLAB; both sides are asked

DOCUMENTED = [
    ("isequal", ("{1,2}", "[2 1]"), [[0.0]]),
    ("isstring", ("'abc'",), [[0.0]]),
    ("isstring", ('"abc"',), [[1.0]]),
    ("isvector", ("zeros(1,0)",), [[1.0]]),
    ("conv", ("2", "[3;1;2]"), [[6.0], [2.0], [4.0]]),
    ("conv", ("[1 2]", "[3;4]"), [[3.0], [10.0], [8.0]]),
    ("sum", ("zeros(0,3)",), [[0.0, 0.0, 0.0]]),
    ("sum", ("[]",), [[0.0]]),
    ("sum", ("reshape(1:8,2,2,2)", "3"), [[6.0, 10.0], [8.0, 12.0]]),
    ("size", ("cell(1,2,3)",), [[1.0, 2.0, 3.0]]),
    ("size", ("zeros(2,3,1)",), [[2.0, 3.0]]),
    ("size", ("find(0)",), [[0.0, 0.0]]),
    ("size", ("diff(5)",), [[0.0, 0.0]]),
    ("size", ("max(zeros(0,3))",), [[0.0, 3.0]]),
    ("sort", ("[3 NaN 1]",), [[1.0, 3.0, np.nan]]),
    ("sort", ("[3 NaN 1]", "'descend'"), [[np.nan, 3.0, 1.0]]),
    ("median", ("[1 NaN 3]",), [[np.nan]]),
    ("pinv", ("0",), [[0.0]]),
    ("bitshift", ("int8(127)", "1"), [[-2.0]]),
    ("bitshift", ("int8(-8)", "-1"), [[-4.0]]),
    ("bitshift", ("uint8(200)", "1"), [[144.0]]),
    ("bitshift", ("1", "200"), [[0.0]]),
    ("bitand", ("int8(-1)", "int8(91)"), [[91.0]]),
    ("bitxor", ("int8(-1)", "int8(91)"), [[-92.0]]),
    ("bitcmp", ("uint8(5)",), [[250.0]]),
    ("bitcmp", ("int8(5)",), [[-6.0]]),
    ("bitset", ("int8(0)", "8"), [[-128.0]]),
    ("bitget", ("int8(-1)", "8"), [[1.0]]),
    ("idivide", ("int32(7)", "int32(-2)"), [[-3.0]]),
    ("idivide", ("int32(7)", "int32(2)", "'ceil'"), [[4.0]]),
    ("mod", ("-5", "Inf"), [[np.inf]]),
    ("mod", ("5", "Inf"), [[5.0]]),
    ("rem", ("-5", "Inf"), [[-5.0]]),
    ("kron", ("[1 2]", "[1;1]"), [[1.0, 2.0], [1.0, 2.0]]),
]


@pytest.mark.parametrize(("name", "texts", "expected"), DOCUMENTED)
def test_both_give_what_is_documented(name, texts, expected):
    arguments = [evaluate(text) for text in texts]
    for side in (in_scripts, in_code):
        [output] = side(name, arguments, 1)
        np.testing.assert_array_equal(output.astype(float), expected)


REFUSED = [
    ("kron", ("[1 2]", "reshape(1:8,2,2,2)")),
    ("diag", ("reshape(1:8,2,2,2)",)),
    ("transpose", ("reshape(1:8,2,2,2)",)),
    ("inv", ("reshape(1:8,2,2,2)",)),
    ("repmat", ("1", "'abc'")),
    ("true", ("'abc'",)),
    ("pi", ("3",)),
    ("size", ("1", "-1")),
    ("sum", ("[1 2]", "1", "'all'")),
    ("var", ("[1 2]", "3")),
]


@pytest.mark.parametrize(("name", "texts"), REFUSED)
def test_both_refuse_what_has_no_value(name, texts):
    arguments = [evaluate(text) for text in texts]
    assert in_scripts(name, arguments, 1) is None
    assert in_code(name, arguments, 1) is None


def test_scripts_pass_over_nan_in_extremes():
    assert evaluate("max(NaN, 1)").tolist() == [[1.0]]
    assert evaluate("min([3 NaN 2])").tolist() == [[2.0]]


def test_options_of_sums_are_not_taken_for_a_dimension():
    assert evaluate("sum([1 2 3], 'double')").tolist() == [[6.0]]
    assert evaluate("sum([1 NaN 3], 'omitnan')").tolist() == [[4.0]]
    assert evaluate("mean([1 NaN 3; 1 1 1], 2, 'omitnan')").tolist() == [[2.0], [1.0]]
    assert evaluate("median([1 NaN 3], 'omitnan')").tolist() == [[2.0]]
    assert evaluate("max([1 NaN 3], [], 'omitnan')").tolist() == [[3.0]]
    with pytest.raises(MatlabError, match="reverse is not supported"):
        evaluate("cumsum([1 2 3], 'reverse')")


# what the generated code leaves of MULTIPLES / STEPS: nothing of a multiple, even if the quotient was rounded down
MULTIPLES = [0.3, -0.3, 0.6, 2.1, -9.1, 0.35, 0.0, 5.0, -0.5, 7.0]
STEPS = [0.1, 0.1, -0.2, 0.7, -1.3, 0.1, 0.1, 0.0, 3.0, 0.0]
LEFT = {
    "mod": [0.0, 0.0, 0.0, 0.0, 0.0, 0.05, 0.0, 5.0, 2.5, 7.0],
    "rem": [0.0, 0.0, 0.0, 0.0, 0.0, 0.05, 0.0, np.nan, -0.5, np.nan],
}


@pytest.mark.parametrize("name", LEFT)
def test_multiples_of_broken_numbers_leave_no_remainder(name, tmp_path):
    output = outputs(f"function y = f(u, v)\ny = {name}(u, v);\nend\n", tmp_path, MULTIPLES, STEPS)
    np.testing.assert_allclose(output, LEFT[name], rtol=1e-12, atol=0)
    numbers = [evaluate(f"{name}({a}, {b})").item() for a, b in zip(MULTIPLES, STEPS, strict=True)]
    np.testing.assert_allclose(numbers, LEFT[name], rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", LEFT)
def test_the_block_leaves_no_remainder_of_multiples(name, tmp_path):
    outputs_of_block = run(
        imported(alone("Math", inputs=2, Operator=name), tmp_path), {"u1": MULTIPLES[:7], "u2": STEPS[:7]}
    )
    np.testing.assert_allclose(outputs_of_block["y1"], LEFT[name][:7], rtol=1e-12, atol=0)
