"""Limits of assignments to reals, and what the report says on numbers."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.ascet.importing import esdl, import_requested
from kennfeld.project.project import Project
from tests.importers.ascet.amd_files import Component, Drawing, Method, message, write_folder
from tests.importers.ascet.esdl_projects import class_model, run, write_project

# `Duty` is kept as an integer of 0.01; `Share` as a floating-point number
TEXT = """type Duty is real 0.0 .. 10.0 delta 0.01; type Share is real -1.0 .. 1.0; type Up is real 2.0 .. ;
type Fine is Duty 1.0 .. 3.0;
class C { Duty d = 0.0; @get Share s = 0.0; @get Duty copy = 0.0; @get Up up = 2.0; @get Fine fine = 1.0;
  Duty doubled(Duty in x) { return x * 2.0; }
  public real calc(real in x) {
    d = x; s = x; copy = d; up = x; fine = x;
    Duty local = x - 1.0;
    d += 1.0;
    return doubled(x) + local * 100.0;
  } }"""
FREE = (-np.inf, np.inf)
X = np.array([-3.0, 0.5, 4.0, 7.0, 20.0])


def clip(values, low, high):
    return np.clip(values, low, high).tolist()


@pytest.mark.parametrize(
    ("choice", "duty", "share"),
    [(None, (0.0, 10.0), FREE), (True, (0.0, 10.0), (-1.0, 1.0)), (False, FREE, FREE)],
)
def test_reals_are_limited_when_they_are_assigned(tmp_path, choice, duty, share):
    model = class_model(tmp_path, TEXT, limit_assignments=choice)
    nodes = run(model, {"x": X})
    assert nodes["d"].tolist() == clip(np.clip(X, *duty) + 1.0, *duty)
    assert nodes["copy"].tolist() == clip(X, *duty)
    assert nodes["s"].tolist() == clip(X, *share)
    fine, up = FREE if choice is False else (1.0, 3.0), (2.0, np.inf) if choice else FREE
    assert (nodes["fine"].tolist(), nodes["up"].tolist()) == (clip(X, *fine), clip(X, *up))
    expected = np.clip(2.0 * np.clip(X, *duty), *duty) + 100.0 * np.clip(X - 1.0, *duty)
    np.testing.assert_allclose(nodes["calc"], expected)


@pytest.mark.parametrize(
    ("choice", "limited", "free"),
    [
        (None, "3 real variables are limited to the range of the type when assigned: Own.C.copy, Own.C.d, Own.C.fine",
         "2 real variables are not limited to the range of the type when assigned: Own.C.s, Own.C.up"),
        (True, "5 real variables are limited", ""),
        (False, "", "5 real variables are not limited"),
    ],
)  # fmt: skip
def test_the_report_names_the_variables_that_are_limited(tmp_path, choice, limited, free):
    remarks = "\n".join(map(str, class_model(tmp_path, TEXT, limit_assignments=choice).remarks))
    assert limited in remarks
    assert free in remarks
    assert ("limit_assignments = false does not limit them" in remarks) is bool(limited)
    assert ("limit_assignments = true limits them" in remarks) is bool(free)


@pytest.mark.parametrize(("flag", "expected"), [("true", [-2.0, 3.0]), ("false", [-9.0, 9.0])])
def test_reals_of_components_are_limited_by_their_implementation(tmp_path, flag, expected):
    drawing = Drawing()
    drawing.write("y", drawing.element("x"), ("calc", 1))
    elements = [message("x"), message("y", "exported", limits=(-2, 3))]
    path = write_folder(tmp_path, Component("Plant", elements, [Method("calc")], drawing))
    file = path.with_name("Plant.implementation.amd")
    file.write_text(file.read_text().replace('limitAssignments="true"', f'limitAssignments="{flag}"'))
    assert run(esdl(path), {"x": [-9.0, 9.0]})["y"].tolist() == expected
    assert run(esdl(path, limit_assignments=False), {"x": [-9.0, 9.0]})["y"].tolist() == [-9.0, 9.0]


@pytest.mark.parametrize(("key", "expected"), [("", [10.0]), ("limit_assignments = false\n", [12.0])])
def test_a_project_decides_whether_reals_are_limited(tmp_path, key, expected):
    text = "package Own;\ntype Duty is real 0.0 .. 10.0 delta 0.01;\nclass C { Duty d = 0.0; " + (
        "public real calc(real in x) { d = x; return d; } }"
    )
    write_project(tmp_path, {"Own/Own/C.esdl": text})
    (tmp_path / "kennfeld.toml").write_text(
        f'[model]\nfile = "Own/Own/C.esdl"\n{key}[[dataset]]\nfiles = "a.csv"\n'
        '[[criterion]]\nnode = "calc"\ntarget = "y"\n'
    )
    project = Project.read(tmp_path / "kennfeld.toml")
    assert not [finding for finding in project.check() if finding.severity != "remark" and "limit" in str(finding)]
    assert (
        run(import_requested(project.file.import_request()).require_model(), {"x": [12.0]})["calc"].tolist() == expected
    )


def test_the_report_says_that_sums_of_integers_do_not_overflow(tmp_path):
    text = "type Wide is integer using uint64; class C {{ Wide n = 0; public integer calc(integer in i) {{ {} }} }}"
    remarks = "\n".join(map(str, class_model(tmp_path, text.format("n = i * 2; return i;")).remarks))
    assert "intermediate results of integers do not overflow" in remarks
    assert "integers of 64 bits are exact up to 2^53: Own.C.n" in remarks
    quiet = "\n".join(map(str, class_model(tmp_path, text.format("return i;")).remarks))
    assert "integers" not in quiet
    with pytest.raises(InputError, match="bit operators of integers of more than 32 bits"):
        class_model(tmp_path, text.format("return n & 3;"))
