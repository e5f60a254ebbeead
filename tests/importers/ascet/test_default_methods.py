"""Methods that a step calls if none is named."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.ascet.importing import esdl, import_esdl
from tests.importers.ascet.amd_files import Component, Drawing, Method, message, write_archive
from tests.importers.ascet.esdl_projects import class_model, run, write_project

TIMER = """class Timer {
    real left = 0.0;
    public void begin(real in start) { left = start; }
    public boolean isElapsed() { return left <= 0.0; }
    public void compute() { left = max(left - 1.0, 0.0); }
    void tick() { compute(); }
}"""


def labels(tmp_path, text, name="C"):
    """Return the methods that are called, and the remark on them."""
    write_project(tmp_path, {"Own/Own/Own.esdl": f"package Own;\n{text}"})
    report = import_esdl(tmp_path / "Own/Own/Own.esdl", name).report
    remarks = [str(remark) for remark in report.remarks if "a step calls" in str(remark)]
    return [label.rpartition(".")[2] for label in report.methods], "".join(remarks)


def test_public_methods_run_in_the_order_of_the_class(tmp_path):
    calls, remark = labels(tmp_path, TIMER, "Timer")
    assert calls == ["isElapsed", "compute"]
    assert "of 3 methods, a step calls isElapsed, compute in the order of the class; begin is skipped" in remark
    assert "chosen by methods; startup names those that run once" in remark
    nodes = run(class_model(tmp_path, TIMER), {}, samples=2)
    assert nodes["isElapsed"].tolist() == [1.0, 1.0]


def test_named_methods_run_in_their_order_without_a_remark(tmp_path):
    model = class_model(tmp_path, TIMER, methods=["begin", "compute"], startup=[])
    assert not any("a step calls" in str(remark) for remark in model.remarks)
    assert run(model, {"start": [3.0, 9.0]})["left"].tolist() == [2.0, 8.0]


@pytest.mark.parametrize(
    ("methods", "expected"),
    [
        # one that calls another runs it, by way of a third as well, or of one that is not public
        ("public void a() { b(); } public void b() { this.c(); } public void c() { x = x + 1.0; }", ["a"]),
        ("public void a() { C.p(); } void p() { b(); } public void b() { x = x + 1.0; }", ["a"]),
        # without side effects, a second call only shows the result
        ("public void a() { x = b(); } @no_side_effect public real b() { return x + 1.0; }", ["a", "b"]),
        # of another class, the same name is another method
        ("D d; public void a() { d.b(); } public void b() { x = x + 1.0; }", ["a", "b"]),
        # what a method that is skipped calls still runs in a step
        ("public void reset() { a(); } public void a() { x = 1.0; } public void b() { x = x + 1.0; }", ["a", "b"]),
        (
            "public void a_ini() { x = 0.0; } public void a() { x = x + 1.0; } public void LIB_Init() { x = 0.0; }",
            ["a"],
        ),
        (
            "@thread public void p_ini() { x = 0.0; } @thread public void p() { x = x + 1.0; } public void q() { }",
            ["p"],
        ),
        ("public extern real f(real in y); public void a() { x = x + 1.0; } public real b() { return x; }", ["a", "b"]),
    ],
)
def test_a_method_runs_once_in_a_step(tmp_path, methods, expected):
    text = f"class D {{ public void b() {{ }} }} class C {{ real x = 0.0; {methods} }}"
    assert labels(tmp_path, text)[0] == expected


def test_a_trigger_runs_the_methods_of_its_actions(tmp_path):
    text = """class C { @get real x = 0.0; public void go() triggers M; public void up() { x = x + 1.0; }
      public void down() triggers M;
      statemachine M { start A; state A { static { up(); } transition x > 1.0 to B { up(); }; } state B { } } }"""
    assert labels(tmp_path, text)[0] == ["go", "down"]


def test_a_class_that_can_only_be_reset_needs_a_choice(tmp_path):
    text = "class C { real x = 0.0; public void init() { x = 1.0; } public void reset() { x = 0.0; } }"
    with pytest.raises(InputError, match=r"which all start or reset it. Name those of a step.*init, reset"):
        class_model(tmp_path, text)


def test_methods_in_c_are_reported_if_there_are_no_others(tmp_path):
    text = "class C { public extern real f(real in y); public extern real g(real in y); }"
    write_project(tmp_path, {"Own/Own/Own.esdl": f"package Own;\n{text}"})
    messages = [finding.message for finding in import_esdl(tmp_path / "Own/Own/Own.esdl").report.findings]
    assert messages == [
        "C.f is implemented in C, which is not supported",
        "C.g is implemented in C, which is not supported",
    ]


def test_processes_of_a_component_run_without_its_initialization(tmp_path):
    drawing = Drawing()
    n = drawing.element("n")
    drawing.write("y", drawing.operator("*", n, drawing.literal("2.0")), ("calc", 1))
    drawing.write("z", drawing.operator("+", n, drawing.element("y")), ("rest", 1))
    drawing.write("y", drawing.literal("9.0"), ("calc_ini", 1))
    elements = [message("n"), message("y", "exported"), message("z", "exported")]
    methods = [Method("calc_ini"), Method("calc"), Method("rest")]
    model = esdl(write_archive(tmp_path, Component("Plant", elements, methods, drawing)))
    np.testing.assert_array_equal(run(model, {"n": [1.0, 2.0]})["z"], [3.0, 6.0])
    assert any("calc_ini is skipped" in str(remark) for remark in model.remarks)
