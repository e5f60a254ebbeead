"""Losses of a written file are reported, aspect by aspect."""

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.calfiles import losses, read, write
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar
from kennfeld.domain.texts import Text
from kennfeld.files.formats import calibration_formats

ENDINGS = (".json", ".csv", ".cdfx", ".dcm", ".xlsx", ".m", ".mat")
LOAD = Axis([0, 1], unit="%")
GROUP = Axis([1, 2, 3], unit="rpm", name="AxisSpeed")
ASPECTS = {
    "description": Scalar("K", 1, description="gain"),
    "unit": Scalar("K", 1, unit="Nm"),
    "unit with a line break": Scalar("K", 1, unit="N\nm"),
    "unicode name": Scalar("Kühlung_µ", 1),
    "display name": Scalar("K", 1, display_name="k"),
    "functions": Scalar("K", 1, functions=["Idle", "Trq"]),
    "variant": Scalar("K", 1, variant="Car=A"),
    "lower bound": Scalar("K", 1, lower=0),
    "lock": Scalar("K", 1, locked=True),
    "missing value": Scalar("K", np.nan),
    "infinite value": Curve("C", [0, 1], [1, np.inf]),
    "axis unit": Curve("C", LOAD, [1, 2]),
    "axis input": Curve("C", Axis([0, 1], input="Load"), [1, 2]),
    "free axis": Curve("C", Axis([0, 1], free=True), [1, 2]),
    "extrapolation": Curve("C", [0, 1], [1, 2], extrapolation="linear"),
    "group axis": Map("M", GROUP, LOAD, [[0, 1], [2, 3], [4, 5]]),
    "block of one column": Block("B", [[1.0], [2.0]]),
    "block of one row": Block("B", [[1.0, 2.0]]),
    "cube": Cube("Q", [LOAD, LOAD, GROUP], np.arange(12.0).reshape(2, 2, 3)),
    "text unit": Text("T", "on", unit="-"),
    "enumeration": Text("T", "on", kind="enumeration"),
    "boolean": Text("T", "true", kind="boolean"),
}


def set_of(item):
    return ParameterSet([], [item]) if isinstance(item, Text) else ParameterSet([item])


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("item", ASPECTS.values(), ids=ASPECTS)
def test_every_aspect_is_restored_refused_or_reported(tmp_path, ending, item):
    path, members = tmp_path / f"a{ending}", set_of(item)
    try:
        write(members, path)
    except InputError:
        return  # refused with a finding, which is loud enough
    warnings = losses(members, path)
    assert (read(path).everything == members.everything) != bool(warnings), warnings


CONTENTS = {
    "cubes": (Cube("Q", [LOAD, LOAD, GROUP], np.zeros((2, 2, 3))), Block("B", np.zeros((2, 2, 2)))),
    "missing values": (Scalar("K", np.nan),),
    "infinities": (Scalar("K", np.inf), Curve("C", [0, 1], [1, -np.inf])),
}


def is_written(item, path):
    try:
        write(set_of(item), path)
    except InputError:
        return False
    return True


@pytest.mark.parametrize("known", calibration_formats(), ids=lambda known: known.name)
def test_the_record_of_a_format_names_what_no_new_file_can_hold(tmp_path, known):
    path, converter = tmp_path / f"a{(known.calibration.endings or known.endings)[0]}", known.calibration
    assert is_written(Scalar("K", 1.0), path) != converter.copies
    if not converter.copies:
        kept = {content: {is_written(item, path) for item in items} for content, items in CONTENTS.items()}
        assert kept == {content: {content not in converter.refuses} for content in CONTENTS}


def test_group_axes_with_another_unit_in_a_table_are_reported_for_cvx(tmp_path):
    tables = ParameterSet([Curve("A", GROUP, [1, 2, 3]), Curve("B", GROUP.changed(unit="1/min"), [1, 2, 3])])
    assert [str(one) for one in losses(tables, "a.csv")] == [
        "a.csv: units of a group axis that differ between tables become that of the first table: 1 label (B). "
        "Write it as .json to keep them."
    ]
    write(tables, tmp_path / "a.xlsx")
    assert (read(tmp_path / "a.xlsx"), losses(tables, "a.xlsx")) == (tables, ())


def test_axis_units_pass_through_cvx(tmp_path):
    table = ParameterSet([Map("M", GROUP, LOAD, [[0, 1], [2, 3], [4, 5]]), Curve("C", LOAD, [1, 2])])
    write(table, tmp_path / "a.csv")
    assert read(tmp_path / "a.csv") == table


def test_many_labels_share_one_remark():
    many = ParameterSet([Scalar(f"K{i}", 1, lower=0) for i in range(9)])
    [warning] = losses(many, "a.dcm")
    assert str(warning) == (
        "a.dcm: bounds are left out: 9 labels (K0, K1, K2, K3, K4 and 4 more). Keep them in a project file."
    )


def test_losses_of_an_unknown_format_are_refused():
    with pytest.raises(ArgumentError, match=r"must end like a calibration file"):
        losses(ParameterSet(), "a.txt")
