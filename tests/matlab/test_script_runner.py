"""Parameter scripts leave the variables that MATLAB would, and tell what they do besides."""

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.matlab.errors import Budget
from kennfeld.matlab.script_runner import run_script
from kennfeld.matlab.simulink_objects import to_calibration_parameter
from kennfeld.matlab.values import MatlabCell, MatlabStruct, class_name, text
from tests.draws import few_or_many, mostly_slow


def values(script, **more):
    """The variables of a script that has nothing to say."""
    outcome = run_script(script, "init.m", **more)
    assert outcome.findings == ()
    return outcome.variables


def findings(script, **more):
    return [str(finding) for finding in run_script(script, "init.m", **more).findings]


ASSIGNMENTS = {
    "a = 1; a(3) = 5;": [[1, 0, 5]],
    "a(2, 3) = 1;": [[0, 0, 0], [0, 0, 1]],
    "a = []; a(end+1) = 4; a(end+1) = 5;": [[4, 5]],
    "a = [1; 2]; a(end+1) = 3;": [[1], [2], [3]],
    "a = 1:5; a([2 4]) = [];": [[1, 3, 5]],
    "p = struct('g', {1, 2, 3}); [p.g] = deal(7); a = [p.g];": [[7, 7, 7]],
    "p(2).g = 1; c = {4, 5}; [p.g] = c{:}; a = [p.g];": [[4, 5]],
    "p = struct([]); p(2).g = 3; a = [numel(p) numel([p.g])];": [[2, 1]],
    "a = 1:5; a(a > 3) = 0;": [[1, 2, 3, 0, 0]],
    "a = 1:3; a(:) = 7;": [[7, 7, 7]],
    "a = zeros(2); a(:, 1) = [1; 2];": [[1, 0], [2, 0]],
    "a = zeros(2); a(2, :) = [3 4];": [[0, 0], [3, 4]],
    "a = zeros(2); a(:) = 1:4;": [[1, 3], [2, 4]],
    "a = eye(3); a(2, :) = [];": [[1, 0, 0], [0, 0, 1]],
    "b = eye(3); b(:) = []; a = size(b);": [[0, 0]],
    "a(:, 1) = [1; 2]; a(:, 2) = [3; 4];": [[1, 3], [2, 4]],
    "a = zeros(2, 2); a(:, end+1) = [5; 6];": [[0, 0, 5], [0, 0, 6]],
    "a = zeros(2, 2); a(2, 2, 2) = 1; a = a(:, :, 2);": [[0, 0], [0, 1]],
    "a = uint8([1 2]); a(1) = 300;": [[255, 2]],
    "a = true(1, 2); a(1) = 0;": [[False, True]],
    "s.a = 1; a = s.a;": 1,
    "s.x.y(3) = 2; a = s.x.y;": [[0, 0, 2]],
    "s(2).a = 5; a = s(2).a;": 5,
    "s(2).a = 5; a = numel(s);": 2,
    "s(1).a = 1; s(2).a = 2; a = [s.a];": [[1, 2]],
    "s.a = 1; s(2).b = 3; a = isempty(s(1).b);": True,
    "s = struct('k', {1, 2}); s(1) = []; a = s.k;": 2,
    "n = 'k'; s.(n) = 4; a = s.k;": 4,
    "c{2} = 5; a = numel(c);": 2,
    "c = {1, 2}; c{1}(3) = 9; a = c{1};": [[1, 0, 9]],
    "c = {1, 2, 3}; c(2) = []; a = c{2};": 3,
    "c = cell(1, 2); c{2}.v = 7; a = c{2}.v;": 7,
    "[m, k] = max([3 9 2]); a = [m k];": [[9, 2]],
    "[~, k] = sort([3 1 2]); a = k;": [[2, 3, 1]],
    "[r, c] = size(zeros(2, 5)); a = [r c];": [[2, 5]],
    "[X, Y] = meshgrid(1:2, 3:4); a = X + Y;": [[4, 5], [5, 6]],
    "a = 0; for i = 1:3, a = a + i; end": 6,
    "a = 0; for i = [1 2; 3 4], a = a + i(2); end": 7,
    "a = 0; for i = {1, 2}, a = a + i{1}; end": 3,
    "a = 1; for i = [], a = 2; end": 1,
    "a = 0; for i = 1:9, if i == 3, continue, end, if i > 4, break, end, a = a + i; end": 7,
    "a = 10; while a > 3, a = a - 2; end": 2,
    "a = 3; if a > 5, a = 1; elseif a > 2, a = 2; else, a = 0; end": 2,
    "if [], a = 1; else, a = 2; end": 2,
    "switch 3, case {1, 2}, a = 1; case 3, a = 2; otherwise, a = 3; end": 2,
    "switch 'b', case 'a', a = 1; case {'b', 'c'}, a = 2; end": 2,
    "switch 9, case 1, a = 1; otherwise, a = 3; end": 3,
    "try, a = undefined_thing; catch, a = 4; end": 4,
    "try, error('no'); catch e, a = numel(e.message); end": 2,
    "f = @(x, y) x*10 + y; a = f(1, 2);": 12,
    "k = 3; f = @(x) x*k; k = 5; a = f(1);": 3,
    "b = 1:3; a = b; a(1) = 9; a = [a b];": [[9, 2, 3, 1, 2, 3]],
    "b = [1 2]; c = {b}; b(1) = 9; a = c{1};": [[1, 2]],
    "b(2) = 1; s.x = b; b(1) = 9; a = s.x;": [[0, 1]],
    "b(2) = 1; f = @() b; b(1) = 9; a = f();": [[0, 1]],
    "a = sq(3);\nfunction y = sq(x)\n  y = x^2;\nend": 9,
    "a = fac(5);\nfunction y = fac(n)\nif n < 2, y = 1; else, y = n*fac(n - 1); end\nend": 120,
    "[p, q] = two(); a = [p q];\nfunction [p, q] = two()\np = 1; q = 2;\nend": [[1, 2]],
    "a = many(1, 2, 3);\nfunction y = many(varargin)\ny = nargin + numel(varargin);\nend": 6,
    "a = early(1);\nfunction y = early(x)\ny = 1; if x, return, end\ny = 2;\nend": 1,
    "x = 5; a = inner();\nfunction y = inner()\ny = exist('x', 'var');\nend": 0,
    "a = 1; clear a; a = exist('a', 'var');": 0,
    "global G; G = 4; a = get();\nfunction y = get()\nglobal G\ny = G;\nend": 4,
    "a = 1; % comment\n%{\na = 2;\n%}": 1,
    "a = [1 2 ... first\n 3];": [[1, 2, 3]],
    "if ~exist('a', 'var'), a = 8; end": 8,
    "assignin('base', 'a', 6);": 6,
    "evens = 2:2:6; a = 0; for e = evens a = a + e; end": 12,
}


@pytest.mark.parametrize(("script", "wanted"), ASSIGNMENTS.items())
def test_a_script_leaves_this_value(script, wanted):
    value = values(script)["a"]
    wanted = np.asarray(wanted)
    wanted = wanted.reshape(1, 1) if wanted.ndim == 0 else wanted
    assert value.tolist() == wanted.tolist()


ENGINE = """%% Engine parameters
clear all; close all; clc; format long
K = 1.2e-3;    % [Nm/rpm] gain
P = Simulink.Parameter(3);
P.Min = 0; P.Max = 10; P.Unit = 'Nm';
P.Description = 'full load';
P.CoderInfo.StorageClass = 'ExportedGlobal';
T = Simulink.LookupTable;
T.Table.Value = [1 2; 3 4]; T.Table.Unit = 'Nm';
T.Breakpoints(1).Value = [700 1000];
T.Breakpoints(2).Value = [10 20];
T.Breakpoints(2).Unit = '%';
N = Simulink.Breakpoint;
N.Breakpoints.Value = [1 2 3];
Q = mpt.Parameter; Q.Value = K*1000;
"""


def test_parameter_objects_have_values_limits_and_units():
    outcome = run_script(ENGINE, "engine.m")
    assert outcome.findings == ()
    assert outcome.comments["K"] == "[Nm/rpm] gain"
    p, t, n, q = (to_calibration_parameter(outcome.variables[name]) for name in "PTNQ")
    assert (p.value.tolist(), p.min, p.max, p.unit, p.description) == ([[3.0]], 0.0, 10.0, "Nm", "full load")
    assert (t.value.tolist(), t.unit, [axis.unit for axis in t.breakpoints]) == ([[1, 2], [3, 4]], "Nm", ["", "%"])
    assert [axis.value.tolist() for axis in t.breakpoints] == [[[700, 1000]], [[10, 20]]]
    assert n.value.tolist() == [[1, 2, 3]]
    assert q.value.tolist() == [[1.2]]
    assert to_calibration_parameter(outcome.variables["K"]) is None


def test_initial_variables_are_available_and_unchanged():
    before = np.array([1.0, 2.0])
    assert values("b = a*2; a(1) = 5;", variables={"a": before})["b"].tolist() == [[2.0, 4.0]]
    assert before.tolist() == [1.0, 2.0]


def test_skipped_calls_are_reported_once():
    script = "figure; plot(1:3)\nhold on\nplot(2)\ndisp('ready')\nset_param('m', 'a', 'b');\nK = 1;"
    assert findings(script) == [
        "init.m line 1: figure skipped",
        "init.m line 1: plot skipped",
        "init.m line 4: disp skipped",
        "init.m line 5: set_param skipped",
    ]


def test_variables_that_depend_on_unknown_functions_are_undefined():
    outcome = run_script("a = 1;\na = readtable('x');\nb = a + 1;\nif b > 1\n c = 1;\nend\nd = 2;", "init.m")
    assert list(outcome.variables) == ["d"]
    assert set(outcome.undefined) == {"a", "b", "c"}
    assert [str(finding) for finding in outcome.findings] == [
        "init.m line 2, column 5: unknown function readtable; a remains undefined. Did you mean real?",
        "init.m line 3, column 5: a is undefined: assignment failed in init.m line 2; b remains undefined",
        "init.m line 4, column 4: b is undefined: assignment failed in init.m line 3; c remains undefined",
    ]


def test_a_variable_that_gets_a_value_again_is_defined():
    assert run_script("a = tf(1); a = 2; b = a;").variables["b"].tolist() == [[2.0]]


def test_only_the_field_that_a_failed_statement_assigns_is_undefined():
    outcome = run_script(
        "par.a = 1;\npar.opt = simset('x');\npar.in.k = simset(1);\npar.in.m = 3;\nc = par.opt + 1;\nd = par.a;"
    )
    par = outcome.variables["par"].fields
    assert (par.keys(), par["in"].fields.keys()) == ({"a", "in"}, {"m"})
    assert outcome.variables["d"].item() == 1
    assert set(outcome.undefined) == {"par.opt", "par.in.k", "c"}
    messages = [str(finding) for finding in outcome.findings]
    assert messages[0].startswith("script.m line 2, column 11: unknown function simset; par.opt remains undefined")
    assert "par.opt is undefined: assignment failed in script.m line 2; c remains undefined" in messages[2]


def test_a_field_that_had_a_value_loses_it_if_its_assignment_fails():
    outcome = run_script("par.a = 1; par.b = 2; if 1, par.a = simset(1); end")
    assert outcome.variables["par"].fields.keys() == {"b"}
    assert set(outcome.undefined) == {"par.a"}


@pytest.mark.parametrize("later", ["par.opt = 2;", "par = struct('opt', 2);"])
def test_a_field_is_defined_again_by_a_later_assignment(later):
    outcome = run_script(f"par.opt = simset(1); {later} x = par.opt;")
    assert outcome.variables["x"].item() == 2
    assert not outcome.undefined


@pytest.mark.parametrize(("over", "turns"), [("zeros(0, 3)", 3), ("zeros(3, 0)", 0), ("[]", 0), ("ones(2, 2, 2)", 4)])
def test_a_loop_runs_once_for_each_column_also_for_empty_ones(over, turns):
    variables = values(f"k = 0; for c = {over}, k = k + 1; end")
    assert variables["k"].item() == turns
    assert "c" in variables


COUNTER = "function y = {name}\npersistent n\nif isempty(n), n = 0; end\nn = n + 1; y = n;\nend\n"


def test_a_persistent_variable_outlasts_the_calls_of_its_function():
    calls = "a = first; b = first; c = second; d = first;\n"
    script = calls + COUNTER.format(name="first") + COUNTER.format(name="second")
    assert [values(script)[name].item() for name in "abcd"] == [1, 2, 1, 3]


def test_a_number_stays_if_a_field_of_it_is_assigned():
    outcome = run_script("a.b = 1; a.d = 4; a.b.c = 2; y = a.b;", "init.m")
    assert outcome.variables["y"].item() == 1
    assert outcome.variables["a"].fields["d"].item() == 4
    assert len(outcome.findings) == 1


def test_the_elements_of_a_struct_array_are_undefined_as_a_whole():
    assert set(run_script("q(1).x = 3; q(2).x = simset(1);").undefined) == {"q"}


def test_the_parts_of_a_path_are_joined():
    paths = values("a = fullfile('sub', 'x.mat'); b = fullfile('sub/', '', '/deep/', 'x.mat');")
    assert ["".join(paths[name].ravel()) for name in "ab"] == ["sub/x.mat", "sub/deep/x.mat"]


def test_the_parts_of_a_path_are_taken_apart():
    paths = values("[a, b, c] = fileparts('sub\\deep/x.y.mat'); [d, e, f] = fileparts('x'); g = filesep;")
    assert ["".join(paths[name].ravel()) for name in "abcdefg"] == ["sub/deep", "x.y", ".mat", "", "x", "", "/"]


def test_a_part_of_an_undefined_variable_cannot_be_assigned():
    assert set(run_script("a = tf(1); a(2) = 1;").undefined) == {"a"}


def test_invalid_statements_are_reported_and_the_others_run():
    outcome = run_script("a = 1;\nb = (;\nc = 3;", "init.m")
    assert [str(finding) for finding in outcome.findings] == [
        "init.m line 2, column 6: a value is missing before ';'",
    ]
    assert set(outcome.variables) == {"a", "c"}


def test_a_failure_after_a_jump_out_of_try_is_reported():
    outcome = run_script("for k = 1:2\n try\n  break\n catch\n end\nend\na = eye(1, 2, 3);\nb = 2;", "init.m")
    assert list(outcome.variables) == ["k", "b"]
    assert [str(finding) for finding in outcome.findings] == [
        "init.m line 7, column 5: eye: a matrix requires two sizes; a remains undefined"
    ]


def test_a_script_that_stops_with_an_error_is_reported():
    outcome = run_script("a = 1;\nif a == 1, error('Wrong engine'), end\nb = 2;", "init.m")
    assert [str(finding) for finding in outcome.findings] == [
        "init.m line 2: the script stops with an error: Wrong engine"
    ]
    assert set(outcome.variables) == {"a"}


FILES = {
    "axes.m": "speed = [1 2 3];",
    "square.m": "function y = square(x)\ny = half(x)*2*x;\nend\nfunction y = half(x)\ny = x/2;\nend",
    "data.mat": {"K": np.array([[4.0]]), "L": {"a": 1.0}},
    "loop.m": "loop",
    "one.m": "two",
    "two.m": "one",
}


def test_other_files_are_run_called_and_loaded():
    workspace = values(
        "axes\nload('data.mat')\nrun('axes.m');\nS = load('data');\na = square(3) + K + S.L.a;\nload data.mat L\n",
        files=FILES.get,
    )
    assert workspace["speed"].tolist() == [[1, 2, 3]]
    assert workspace["a"].tolist() == [[14.0]]


def test_files_that_are_not_there_are_findings():
    messages = findings("load('nothing.mat')\nrun other\nother2\nS = load('data.mat', 'Z');", files=FILES.get)
    assert messages == [
        "init.m line 1, column 1: file nothing.mat not found",
        "init.m line 2, column 1: file other.m not found",
        "init.m line 3, column 1: other2 is not defined. Did you mean interp2?",
        "init.m line 4, column 5: data.mat does not contain the variable Z; S remains undefined",
    ]


def test_files_that_a_script_needs_and_does_not_find_are_listed():
    script = "load('nothing.mat')\nrun other\nother2\nplot(K)\nx = unknown + K;\naxes"
    assert run_script(script, files=FILES.get).missing_files == ("nothing.mat", "other.m", "other2.m")


def test_scripts_that_call_each_other_come_to_an_end():
    assert "calls itself" in findings("loop", files=FILES.get)[0]
    assert "calls itself" in findings("one", files=FILES.get)[0]


def test_a_file_of_one_function_without_parameters_is_its_body():
    struct = values("function p = engine()\np.K = 2;\nend")["p"]
    assert isinstance(struct, MatlabStruct)
    assert struct.fields["K"].tolist() == [[2.0]]


def test_functions_of_the_caller_are_called():
    assert values("a = gain(2);", functions={"gain": lambda x: x * 3})["a"].tolist() == [[6.0]]


def test_texts_and_cells_grow():
    variables = values("c{3} = 'x'; w = 'ab'; w(end+1) = 'c'; names = {}; names{end+1} = 'a'; names{end+1} = 'b';")
    assert isinstance(variables["c"], MatlabCell)
    assert text(variables["w"]) == "abc"
    assert [text(one) for one in variables["names"].values.ravel()] == ["a", "b"]


@pytest.mark.parametrize(
    ("script", "message"),
    {
        "a = zeros(2); a(:, 3) = [1 2 3];": "values of size 1 x 3 cannot be assigned to a part of size 2 x 1",
        "a = 1:3; a(1:2) = [1 2 3];": "3 values cannot be assigned to 2 elements",
        "a = eye(2); a(7) = 1;": "a matrix cannot grow by a single index",
        "a = eye(3); a(1, 2) = [];": "only whole rows or columns can be removed",
        "a = 5; a.b = 1;": "a double has no field b",
        "a = {1}; a.b = 1;": "a cell has no field b",
        "a = 5; a{2} = 1;": "a double cannot be indexed with braces",
        "s(2).a = 1; s.a = 5;": "expected one struct, got 2",
        "[a, b] = 5;": "fewer values than targets",
        "a = f();\nfunction f()\nend": "fewer values than targets",
        "a = f();\nfunction y = f()\nend": "f does not assign its output y: no assignment was reached",
        "a = f(1, 2);\nfunction y = f(x)\ny = x;\nend": "f takes 1 arguments, got 2",
    }.items(),
)
def test_an_assignment_that_does_not_fit_is_findings(script, message):
    assert message in findings(script)[-1]


HOSTILE = [
    "while true, end",
    "x = 1; while true, x(end+1) = 1; end",
    "A = [1 1]; while true, A = [A A]; end",
    "s = 'a'; while true, s = strrep(s, 'a', 'aa'); end",
    "A = ones(500); while true, A = A*A; end",
    "c = {}; while true, c = {c, c}; end",
    "s.a = 1; for i = 1:1e6, s.a = s; end",
    "x = zeros(1e9); y = 1; for i = 1:1e9, y = y + 1; end",
    "x(1e9) = 1; x(1e5, 1e5) = 1;",
    "f\nfunction f\nf\nend",
    "f = @(f) f(f); f(f)",
    "f = @(g, n) g(g, n + 1); f(f, 1)",
    "if a\n" * 10_000,
    "x = [" * 10_000,
    "x" + ".a" * 10_000 + " = 1;",
    "x = 1" + "+1" * 10_000 + ";",
    "x = repmat('a', 1, 1e9); y = sprintf('%500d', 1:1e6);",
    "x = primes(1e12); y = nchoosek(1e9, 2); z = factorial(1e9); w = magic(1e6);",
    "x = kron(ones(3000), ones(3000)); y = conv(1:1e6, 1:1e6);",
]


@pytest.mark.parametrize("script", mostly_slow(HOSTILE, [*HOSTILE[2:15], *HOSTILE[16:]]), ids=range(len(HOSTILE)))
def test_hostile_scripts_end_in_a_finding(script):
    outcome = run_script(script, "init.m", budget=Budget(steps=30_000, elements=5_000_000))
    assert outcome.findings
    assert all(str(finding.location).startswith("init.m line ") for finding in outcome.findings)


PIECES = ["a", "b", "s", "c", " = ", "1", "[1 2]", "(2)", "{2}", ".f", ";\n", ", ", "if a\n", "for a=1:2\n", "end\n"]
PIECES += [
    "while a\n",
    "break;\n",
    "(:,1)",
    "(end+1)",
    "[]",
    "'x'",
    "a = 1;\n",
    "s.f = 1;\n",
    "c{2} = 1;\n",
    "(a)",
    "*",
]
PIECES += ["function y = a(b)\n", "return;\n", "clear a\n", "try\n", "catch\n", "[a, b] = ", "struct('f', {1, 2})"]


@few_or_many(st.lists(st.sampled_from(PIECES), max_size=15).map("".join), few=20, many=100)
def test_any_script_has_an_outcome(script):
    outcome = run_script(script, "init.m", budget=Budget(steps=500, elements=10_000))
    assert all(class_name(value) for value in outcome.variables.values())
