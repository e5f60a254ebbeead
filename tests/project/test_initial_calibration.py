"""Today's calibration in a project: which variant counts, and the file that a run writes from it."""

import numpy as np
import pytest

from kennfeld.project.results import write

START = """* a remark of the owner
KONSERVIERUNG_FORMAT 2.0
FESTWERT offset
  WERT 1.50
END
FESTWERT factor
  VAR Engine=1
  WERT 1.0
END
FESTWERT factor
  VAR Engine=2
  WERT 2.0
END
FESTWERT elsewhere
  WERT 7.00\x20\x20
  UNKNOWN 1
END
"""


@pytest.fixture
def line(shop):
    shop.text = "y = factor * x + offset"
    x = np.arange(10.0)
    shop.csv("bench.csv", {"x": x, "z": 3 * x + 4})
    (shop.folder / "start.dcm").write_text(START)
    shop.toml = (
        "model.file = 'sensor.kf'\n[[dataset]]\nfiles = 'bench.csv'\n[[criterion]]\nnode = 'y'\ntarget = 'z'\n"
        "[calibration]\ninitial = 'start.dcm'\noutput = 'dcm'\n"
    )
    return shop


def calibrated(shop):
    project = shop.project
    write(project.calibrate(), project, shop.folder / "results")
    return (shop.folder / "results/parameters.dcm").read_text().splitlines()


def test_the_calibrated_dcm_is_the_start_with_other_numbers(line):
    before, after = START.splitlines(), calibrated(line)
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert [old for old, _ in changed] == ["  WERT 1.50", "  WERT 1.0"]
    assert [float(new.split()[1]) for _, new in changed] == pytest.approx([4, 3])


PAR = "CANape PAR V3.1: ecu.a2l 1 0 ECU\r\n;owner\r\noffset [FLOAT(32)] 1.5 ; 1.50\r\nfactor [FLOAT(32)] 1 ; 1.00\r\n"


def test_a_parameter_file_of_canape_is_the_start_with_other_numbers(line):
    (line.folder / "start.par").write_bytes(PAR.encode())
    line.toml = line.toml.replace("start.dcm", "start.par").replace("output = 'dcm'", "output = 'par'")
    project = line.project
    write(project.calibrate(), project, line.folder / "results")
    rows = (line.folder / "results/parameters.par").read_bytes().decode().splitlines()
    assert rows[:2] == PAR.splitlines()[:2]
    assert [float(row.split()[2]) for row in rows[2:]] == pytest.approx([4, 3])


def test_a_parameter_file_of_canape_needs_one_to_write_over(line):
    line.toml = line.toml.replace("output = 'dcm'", "output = 'par'")
    assert any("par requires a parameter file of CANape" in str(finding) for finding in line.project.check())


def test_the_requested_variant_is_fitted_and_written(line):
    line.toml += "variant = 'Engine=2'\n"
    assert line.project.problem().parameters["factor"].value == 2
    changed = [old for old, new in zip(START.splitlines(), calibrated(line), strict=True) if old != new]
    assert changed == ["  WERT 1.50", "  WERT 2.0"]


def test_a_missing_variant_is_reported_with_the_existing_ones(line):
    line.toml += "variant = 'Engine=3'\n"
    [finding] = [str(finding) for finding in line.findings() if "variant" in str(finding)]
    assert "[calibration] variant: no parameter has the variant 'Engine=3'" in finding
    assert "Engine=1, Engine=2" in finding


def test_skipped_parts_of_a_file_are_remarks(line):
    (line.folder / "start.dcm").write_text(START + 'KENNLINIE T 2\n ST_TX/X "a" "b"\n WERT 1 2\nEND\n')
    findings = [finding for finding in line.project.check() if "skipped" in finding.message]
    assert [(finding.severity, str(finding.location)) for finding in findings] == [
        ("remark", "start.dcm line 16 (elsewhere)"),
        ("remark", "start.dcm line 18 (T)"),
    ]


def test_many_remarks_on_a_file_are_summarised(line):
    tables = "".join(f'KENNLINIE T{i} 2\n ST_TX/X "a" "b"\n WERT 1 2\nEND\n' for i in range(10))
    (line.folder / "start.dcm").write_text(START + tables)
    [remark] = [finding for finding in line.project.check() if finding.severity == "remark"]
    assert str(remark) == ("start.dcm: 11 entries were skipped or are unusual. List them with kennfeld info start.dcm.")
