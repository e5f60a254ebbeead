"""Projects whose recordings are bus logs, decoded by the databases of their datasets."""

import pytest

from kennfeld.base.errors import InputError
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.project import Project
from kennfeld.report.provenance import sources
from tests.measurement.bus_files import DBC, Frame, drive, engine, write_mf4
from tests.project.partitioned_projects import in_partitions

FORMULA = "Predicted = Offset + Gain * n\nscalar Offset\nscalar Gain\n"
PROJECT = """
[model]
file = "sensor.kf"

[channels]
n = "Engine.Speed"

[[dataset]]
files = ["drive_*.mf4"]
{dbc}

[parameters]
Offset = {{ initial = 0.0 }}
Gain = {{ initial = 0.0 }}

[[criterion]]
node = "Predicted"
target = {{ channel = "Temp" }}
"""


@pytest.fixture
def project(tmp_path):
    """Two drives whose temperature is 10 + 0.02 speed; `dbc` is the key of the dataset."""

    def write(dbc):
        (tmp_path / "sensor.kf").write_text(FORMULA)
        (tmp_path / "kennfeld.toml").write_text(PROJECT.format(dbc=dbc))
        (tmp_path / "engine.dbc").write_text(DBC)
        for name, first in (("a", 1000), ("b", 3000)):
            speeds = [first + 50 * k for k in range(30)]
            frames = [Frame(0.01 * k, 500, engine(n, 10 + 0.02 * n)) for k, n in enumerate(speeds)]
            write_mf4(tmp_path / f"drive_{name}.mf4", frames)
        return tmp_path / "kennfeld.toml"

    return write


def findings(path):
    try:
        return [str(finding) for finding in Project.read(path).check()]
    except InputError as error:
        return [str(finding) for finding in error.findings]


def cost_in_partitions(path):
    compiled = CompiledProblem(in_partitions(path, 20).problem())
    return compiled.sums.cost(compiled.start)


@pytest.mark.parametrize(
    "dbc", ['dbc = "engine.dbc"', 'dbc = ["*.dbc"]', 'dbc = [{ file = "engine.dbc", bus = 1 }, "engine.dbc"]']
)
def test_a_project_is_calibrated_on_decoded_signals(project, dbc):
    parameters = Project.read(project(dbc)).calibrate().parameters
    assert parameters["Gain"].value == pytest.approx(0.02, rel=1e-2)
    assert parameters["Offset"].value == pytest.approx(10.0, rel=0.1)


def test_partitions_are_decoded_like_whole_files(project):
    path = project('dbc = "engine.dbc"')
    plain, parted = (CompiledProblem(p.problem()) for p in (Project.read(path), in_partitions(path, 20)))
    assert parted.sums.cost(parted.start) == pytest.approx(plain.sums.cost(plain.start), rel=1e-12)


def test_prepared_partitions_follow_the_content_of_the_database(project, tmp_path):
    path = project('dbc = "engine.dbc"')
    before = cost_in_partitions(path)
    (tmp_path / "engine.dbc").write_text(DBC.replace("(1,-40)", "(1,-50)"))
    assert cost_in_partitions(path) < before


def test_a_bus_log_without_a_database_names_the_key(project):
    messages = findings(project(""))
    assert messages[0].startswith(
        "drive_a.mf4: this is a bus log: it holds 30 CAN frames of 1 identifier on CAN1 (0x1F4)"
    )
    assert 'dbc = ["engine.dbc"] in the [[dataset]]' in messages[0]


def test_a_missing_database_is_an_error_of_its_key(project):
    assert findings(project('dbc = "enigne.dbc"')) == [
        "kennfeld.toml line 10 [[dataset]] 1 dbc: enigne.dbc matches no file. Did you mean engine.dbc?"
    ]


def test_a_database_of_another_bus_decodes_no_signals(project):
    messages = findings(project('dbc = { file = "engine.dbc", bus = 2 }'))
    assert "none of its identifiers is described by engine.dbc" in messages[0]
    assert messages[0].endswith("Check the database, and its bus if one is stated.")


@pytest.mark.parametrize(
    ("dbc", "message"),
    [
        ("dbc = 3", "must be a file, got 3. Write dbc ="),
        ("dbc = { bus = 1 }", "file: the key is missing"),
        ('dbc = { file = "engine.dbc", bus = 0 }', "must be an integer >= 1, got 0"),
        ('dbc = { file = "engine.dbc", network = "FlexRay" }', "network"),
    ],
)
def test_invalid_values_are_refused_with_their_line(project, dbc, message):
    messages = findings(project(dbc))
    assert messages[0].startswith("kennfeld.toml line 10 [[dataset]] 1 dbc")
    assert message in messages[0]


def test_a_message_of_a_raster_of_its_own_needs_a_raster(project, tmp_path):
    path = project('dbc = "engine.dbc"')
    path.write_text(path.read_text().replace('channel = "Temp"', 'channel = "Gear"'))
    for name in ("a", "b"):
        write_mf4(tmp_path / f"drive_{name}.mf4", drive())
    assert "the channels have different rasters" in findings(path)[0]
    path.write_text(path.read_text().replace("[parameters]", "raster = 0.02\n[parameters]", 1))
    assert not any("rasters" in finding for finding in findings(path))


def test_the_report_lists_the_databases(project):
    listed = sources(Project.read(project('dbc = "engine.dbc"')))
    assert "CAN database" in [source.role for source in listed]
