"""`kennfeld info` of files of functions, and of one of their functions."""

import json

import pytest

from kennfeld.cli import run

pytestmark = pytest.mark.guests

C_FILE = """
    const volatile double GAIN[3] = {1, 2, 3};
    const volatile unsigned char MODE = 1;
    typedef struct { double x; } In;
    double step(const In *in, int gear, double *y) { static double last; *y = last; last = in->x; return GAIN[gear]; }
    double other(double (*f)(double)) { return f(1.0); }
"""
PYTHON_FILE = """
def eta(speed, load, offset=0.5):
    return speed * load, offset

def loose(*values):
    return values
"""


def _lines(capsys):
    return [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]


def test_info_of_a_c_file_lists_its_functions(tmp_path, capsys, monkeypatch):
    pytest.importorskip("pycparser")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f.c").write_text(C_FILE)
    assert run(["info", "f.c"]) == 0
    lines = _lines(capsys)
    assert lines[0] == "f.c: 2 functions"
    assert "step const In *in, int gear, double *y double, double *y" in lines
    assert any(line.startswith("other") and "pointer" in line for line in lines)


def test_info_of_a_python_file_lists_its_functions(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f.py").write_text(PYTHON_FILE)
    assert run(["info", "f.py", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    first, second = content["functions"]
    assert first["arguments"] == ["speed", "load", "offset = 0.5"]
    assert len(first["results"]) == 2
    assert "loose" in second["name"]
    assert second["problem"]


def test_info_of_a_function_shows_parameters_and_states(tmp_path, capsys, monkeypatch):
    pytest.importorskip("pycparser")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f.c").write_text(C_FILE)
    assert run(["info", "f.c:step"]) == 0
    lines = _lines(capsys)
    assert lines[0] == "f.c:step: function, with states"
    assert {"in.x", "gear", "GAIN curve 3", "step.last", "step", "y"} <= set(lines)


def test_info_of_a_damaged_file_is_one_message(tmp_path, capsys):
    pytest.importorskip("pycparser")
    (tmp_path / "f.c").write_text("double step(double x) { return x +; }")
    assert run(["info", str(tmp_path / "f.c")]) != 0
    assert "f.c line 1" in capsys.readouterr().err
