"""Structs of generated and of hand-written C code, compared with compiled functions by `scripts/c_functions.py`."""

import sys

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.function_files import read_function_file
from kennfeld.models.model_function import as_model
from tests.importers.c.compiled import needs_compiler

pytest.importorskip("pycparser")

import c_functions  # of `scripts`

GENERATED = """
    #include "rtwtypes.h"
    typedef struct { real_T delay; real32_T ring[3]; uint8_T at; } DW_T;
    typedef struct { real_T speed; real_T load; struct { real_T a; real_T b[2]; } bus; } ExtU_T;
    typedef struct { real_T torque; real_T held; } ExtY_T;
    typedef struct { real_T gain; real_T table[5]; uint8_T on; } P_T;
    DW_T rtDW; ExtU_T rtU; ExtY_T rtY;
    P_T rtP = { 2.5, { 1.0, 2.0, 4.0, 8.0, 16.0 }, 1U };
    #define CLIP(x, low, high) (((x) < (low)) ? (low) : (((x) > (high)) ? (high) : (x)))
    #if defined(UNKNOWN) || 0
    #error not read
    #endif
    static const real_T places[5] = { 0.0, 1.0, 2.0, 3.0, 4.0 };
    static real_T look(real_T u, const real_T *x, const real_T y[], int32_T n)
    {
        int32_T i = 0;
        while ((i < n - 2) && (u > x[i + 1])) { i++; }
        return y[i] + CLIP((u - x[i]) / (x[i + 1] - x[i]), 0.0, 1.0) * (y[i + 1] - y[i]);
    }
    void model_step(void)
    {
        real_T sum = look(rtU.speed, places, rtP.table, 5) + rtU.bus.b[1];
        rtDW.ring[rtDW.at] = sum;
        rtDW.at = (uint8_T)((rtDW.at + 1U) % 3U);
        rtY.torque = rtP.gain * sum + rtDW.delay + rtDW.ring[0];
        if (rtP.on && (rtU.load > 0.0)) { rtY.held = rtU.load; }
        rtDW.delay = rtU.bus.a;
    }
    void model_initialize(void)
    {
        rtDW.delay = 3.0;
        rtU.speed = 0.0;
    }
"""
POINTERS = """
    typedef struct { float a, b; } Gains;
    typedef struct { double set; float measured; Gains gains; } In;
    typedef struct { double value; int saturated; } Out;
    typedef struct { double sum; struct { double last; int calls; } inner[2]; } State;
    static void count(State *s, int at) { s->inner[at].calls += 1 + at; }
    static double error_of(const In *in) { return in->set - in->measured; }
    void control(const In *in, Out *out, State *s)
    {
        const Gains *gains = &in->gains;
        State old = *s;
        double e = error_of(in);
        s->sum += gains->b * e * 0.01;
        s->inner[1].last = old.inner[0].last;
        s->inner[0].last = e;
        count(s, 0);
        count(s, 1);
        out->value = gains->a * e + s->sum + old.inner[1].last + s->inner[1].calls;
        out->saturated = out->value > 10.0;
        if (out->saturated) { out->value = 10.0; }
    }
    void vectors(const double x[3], double y[2]) { y[0] = x[0] * x[1]; y[1] = x[2] - y[0]; }
"""
CONTROLLER = """
    typedef struct { float Kp, Ki; float sum, last; float out; } Controller;
    float update(Controller *c, float set, float measured)
    {
        float error = set - measured;
        c->sum += 0.5f * c->Ki * (error + c->last);
        c->last = error;
        c->out = c->Kp * error + c->sum;
        return c->out;
    }
    void run(Controller *c) { update(c, c->Kp, 1.0f); }
"""


def _function(text, name, folder):
    (folder / "f.c").write_text(text)
    return read_function_file(f"f.c:{name}", folder)


def _names(ports):
    return [port.name for port in ports]


@needs_compiler
@pytest.mark.slow
def test_structs_are_computed_as_the_compiler_computes_them(tmp_path, monkeypatch, capsys):
    for name, text in {"generated": GENERATED, "pointers": POINTERS, "controller": CONTROLLER}.items():
        (tmp_path / f"{name}.c").write_text(text)
    monkeypatch.setattr(sys, "argv", ["c_functions.py", str(tmp_path), "--calls", "15", "--list"])
    status = c_functions.main()
    agreeing = [line.split(":")[1] for line in capsys.readouterr().out.splitlines() if ": agree" in line]
    assert agreeing == ["update", "run", "model_step", "model_initialize", "error_of", "control", "vectors"]
    assert status == 0  # nothing differs


def test_members_read_are_inputs_and_structs_named_as_outputs_are_outputs(tmp_path):
    function = _function(GENERATED, "model_step", tmp_path)
    assert _names(function.inputs) == ["rtU.speed", "rtU.load", "rtU.bus.a", "rtU.bus.b[0]", "rtU.bus.b[1]"]
    assert _names(function.outputs) == ["rtY.torque", "rtY.held"]
    assert function.memory


def test_a_remark_names_the_initialization_that_does_not_run(tmp_path):
    (remark,) = _function(GENERATED, "model_step", tmp_path).remarks[-1:]
    assert "model_initialize sets rtDW.delay" in remark.message


def test_the_size_of_an_array_behind_a_pointer_follows_from_constant_indices(tmp_path):
    function = _function("double step(const float *x, float *y) { y[1] = x[2]; return x[0]; }", "step", tmp_path)
    assert _names(function.inputs) == ["x[0]", "x[1]", "x[2]"]
    assert _names(function.outputs) == ["step", "y[0]", "y[1]"]


def test_structs_of_parameters_are_parameters_with_the_values_of_the_file(tmp_path):
    values = _function(GENERATED, "model_step", tmp_path).values
    assert list(values) == ["rtP.gain", "rtP.table", "rtP.on"]
    np.testing.assert_array_equal(values["rtP.table"].values, [1.0, 2.0, 4.0, 8.0, 16.0])


def test_formula_text_names_elements_by_dots(tmp_path):
    (tmp_path / "f.c").write_text(POINTERS)
    function = read_function_file("f.c:vectors", tmp_path, "v")
    assert function.calls == {"v.y.0": 0, "v.y.1": 1}


def test_members_of_a_struct_that_is_returned_are_outputs(tmp_path):
    text = "typedef struct { double x; float y[2]; } Out; Out step(double u) { return (Out){u, {1, u}}; }"
    function = _function(text, "step", tmp_path)
    assert _names(function.outputs) == ["step.x", "step.y[0]", "step.y[1]"]


def test_a_member_of_a_union_counts_where_it_is_the_one_written_last(tmp_path):
    text = """
        typedef struct { int kind; union { double number; int whole; }; } Out;
        void step(double u, Out *out) { out->kind = u > 0; if (u > 0) out->number = u; else out->whole = (int)u; }
    """
    function = _function(text, "step", tmp_path)
    assert _names(function.outputs) == ["out.kind", "out.number", "out.whole"]
    nodes = evaluate(as_model(function).graph, {"u": np.array([2.5, -3.5])}, ParameterSet())
    np.testing.assert_array_equal(nodes["out.number"], [2.5, np.nan])
    np.testing.assert_array_equal(nodes["out.whole"], [np.nan, -3.0])


def test_a_struct_that_is_only_written_gives_outputs_and_one_that_is_also_read_states(tmp_path):
    function = _function(POINTERS, "control", tmp_path)
    assert _names(function.inputs) == ["in.set", "in.measured", "in.gains.a", "in.gains.b"]
    assert _names(function.outputs) == ["out.value", "out.saturated"]
    assert function.memory


def test_members_of_one_struct_are_inputs_and_states_of_a_function_that_returns_a_number(tmp_path):
    function = _function(CONTROLLER, "update", tmp_path)
    assert _names(function.inputs) == ["c.Kp", "c.Ki", "set", "measured"]
    assert _names(function.outputs) == ["update"]


def test_members_set_anew_are_the_outputs_of_a_function_that_returns_nothing(tmp_path):
    assert _names(_function(CONTROLLER, "run", tmp_path).outputs) == ["c.out"]


def test_an_included_file_of_the_folder_is_read(tmp_path):
    (tmp_path / "types.h").write_text("#pragma once\ntypedef struct { double x; } In;\n#define TWICE(a) (2 * (a))\n")
    text = '#include "types.h"\n#include "types.h"\ndouble step(const In *in) { return TWICE(in->x + 1); }'
    assert _names(_function(text, "step", tmp_path).inputs) == ["in.x"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("typedef struct { int a : 3; } S; double step(S *s) { return s->a; }", "a is a bit field"),
        (
            "typedef union { int a; float b; } U; double step(float x) { U u; u.b = x; return u.a; }",
            "u.a is read, but b was written last",
        ),
        (
            "union { int a; float b; } static u; double step(float x) { double y = u.b; u.a = x; return y; }",
            "u.b is read, but u.a is written, which overlaps with it",
        ),
        (
            "typedef union { int a; float b; } U; static void f(int *a, float *b) { *a = 1; *b = 2; }"
            "double step(float x) { U u; f(&u.a, &u.b); return u.b; }",
            "two names",
        ),
        ("struct S { int *p; }; struct S f(int x); struct S step(struct S s) { return s; }", "a is a pointer|returns"),
        ("double step(double (*f)(double), double x) { return f(x); }", "argument f is"),
        ("double step(double x) { goto end; end: return x; }", "goto is not supported"),
        (
            "static double y; static void f(double *a) { *a = y; } double step(double x) { f(&y); return x; }",
            "two names",
        ),
        ("double step(const double *x, int n) { return x[n]; }", "array of unknown size"),
        ("double step(double x) { double a[3] = {x}; return a[3]; }", "index 3 of a, which has 3 elements"),
        ("static double a[2]; double step(double x) { int i; for (i = 0; i < 3; i++) a[i] = x; return x; }", "range"),
        ("#define F(a, b) a\ndouble step(double x) { return F(x); }", "takes 2 arguments, got 1"),
        (
            "typedef struct { double v; } In; typedef struct { In *in; } S;"
            "double step(S *s, double u) { S t = *s; t.in->v = u; return s->in->v; }",
            "s has pointers, so that it cannot be copied",
        ),
        (
            "typedef struct { double v; } In; typedef struct { In *in; } S; static void f(S t) { t.in->v = 1; }"
            "double step(S *s) { f(*s); return s->in->v; }",
            "f sets t.in.v through a pointer of a struct that it gets by value",
        ),
        ("double *p; double step(double x) { return *p + x; }", "the pointer p must be set where it is declared"),
        ("double step(struct s *x) { return x->y; }", "members are not known"),
    ],
)
def test_what_is_not_supported_is_named(text, message, tmp_path):
    with pytest.raises(InputError, match=message):
        _function(text, "step", tmp_path)


def test_errors_behind_the_first_are_reported_as_well(tmp_path):
    text = "double a(double x) {\n  return x +;\n}\n\ndouble step(double x) {\n  return * / x;\n}\n"
    with pytest.raises(InputError) as error:
        _function(text, "step", tmp_path)
    assert [finding.location.line for finding in error.value.findings] == [2, 6]
