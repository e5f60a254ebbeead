"""Every file gets one answer, whoever asks: the command line, Python or the app."""

import gzip
import zipfile

import pytest
from fuzz_samples import CORE, GUESTS

import kennfeld as kf
from kennfeld.app.questions.additions import kinds_of
from kennfeld.base.errors import InputError
from kennfeld.calfiles.cvx.writer import write_cvx
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.files import Role, identify
from kennfeld.terminal.file_info import describe_file
from tests.draws import mostly_slow

CONTENTS = {"measurement": "recording", "calibration": "calibration", "formula": "function", "project": "project"}
TEXTS = {
    "drive.csv": "time,Speed\n0,1000\n0.1,1010\n0.2,1020\n",
    "start.dcm": "KONSERVIERUNG_FORMAT 2.0\n\nFESTWERT Gain\n   WERT 12.5\nEND\n",
    "bare.dcm": "FESTWERT Gain\n   WERT 12.5\nEND\n",
    "start.csv": write_cvx(ParameterSet([Scalar("Gain", 12.5)]), "start.csv"),
    "start.json": '{"Gain": {"kind": "scalar", "unit": "", "value": 12.5}}',
    "start.m": "% gains\nGain = 12.5;  % [Nm] at idle\n",
    "words.m": "FUNKTIONEN = 3;\nFESTWERT\t= [1 2];  % words of DCM\nGain = 12.5;\n",
    "sensor.kf": "# a sensor\ny[Nm] = Gain * x\nscalar Gain\n",
    "drive.asc": "date Sat Nov 28 10:00:00 2026\nbase hex  timestamps absolute\n 0.1 1 100 Rx d 1 00\n",
    "drive.msl": '"MS3"\n"Captured"\nTime\tRPM\n0\t900\n0.1\t910\n',
    "control.a2l": 'ASAP2_VERSION 1 61\n/begin PROJECT P ""\n/end PROJECT\n',
    "engine.dbc": 'VERSION ""\n\nBO_ 256 Engine: 8 Vector__XXX\n SG_ Speed : 0|16@1+ (1,0) [0|0] "rpm" X\n',
    "pump.esdl": "package engine;\nstatic class Pump { characteristic real gain = 2.0; }\n",
}


def answers(path):
    """The role of a file as the command line, the app and `identify` tell it, and whether Python reads it as that."""
    role = identify(path).role
    try:
        content = CONTENTS.get(describe_file(path).as_json.get("content", ""), role.value)
    except InputError:  # of a file that describes others, or that names files which are not there
        content = role.value
    try:
        dropped = kinds_of(path.parent, [path.name])[path.name]
    except InputError:
        dropped = "none"
    expected = "none" if role is Role.PROJECT else "calibration" if role is Role.SURROGATE else role.value
    return role.value, content, role.value if dropped == expected else dropped


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.guests) if name == "pump.esdl" else name for name in TEXTS]
)
@pytest.mark.parametrize("form", ["plain", "mark", "utf-16", "gzip", "zip", "other ending", "no ending"])
def test_a_file_gets_one_answer_in_every_form(tmp_path, name, form):
    text = TEXTS[name]
    names = {"gzip": f"{name}.gz", "zip": f"{name}.zip", "other ending": "a.txt", "no ending": "a"}
    path = tmp_path / names.get(form, name)
    content = text.encode({"mark": "utf-8-sig", "utf-16": "utf-16"}.get(form, "utf-8"))
    if form == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(name, content)
    else:
        path.write_bytes(gzip.compress(content) if form == "gzip" else content)
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / name).write_text(text, encoding="utf-8")
    role = identify(tmp_path / "plain" / name).role
    if form in ("gzip", "zip") and role not in (Role.RECORDING, Role.CALIBRATION):
        with pytest.raises(InputError, match="which is read only if it is not compressed"):
            identify(path)
        return
    assert answers(path) == (role.value,) * 3
    if role is Role.CALIBRATION:
        assert kf.read_parameters(path)["Gain"].value == 12.5
        with pytest.raises(InputError):
            kf.read(path)


UNSIGNED = {".c", ".py", ".app", ".onnx"}  # languages that nothing but the ending tells


def samples_by_kind(makers):
    """Yield one sample of each kind."""
    seen = set()
    for sample in (sample for maker in makers for sample in maker(5)):
        if sample.kind not in seen:
            seen.add(sample.kind)
            yield sample


def in_form(folder, sample, form):
    """Write a sample in a form; return its path, None if it has no such form."""
    for name, content in sample.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    path = folder / sample.name
    content = path.read_bytes()
    if form == "gzip":
        packed = path.with_name(f"{path.name}.gz")
        packed.write_bytes(gzip.compress(content))
        path.unlink()
        return None if sample.name.endswith(".gz") else packed
    if form in ("mark", "utf-16"):
        try:
            text = content.decode("utf-8")
        except UnicodeDecodeError:
            return None
        path.write_bytes(text.encode({"mark": "utf-8-sig"}.get(form, form)))
        return None if "\0" in text or text.startswith("\ufeff") else path
    if form != "plain" and path.suffix in UNSIGNED:
        return None
    names = {"wrong ending": f"{path.stem}{'.dat' if path.suffix == '.txt' else '.txt'}", "no ending": "a"}
    return path.rename(path.with_name(names.get(form, path.name)))


MAKERS = pytest.mark.parametrize(
    ("makers", "fewest"),
    [pytest.param(CORE, 5, id="core"), pytest.param(GUESTS, 5, id="guests", marks=pytest.mark.guests)],
)


@MAKERS
@pytest.mark.parametrize("form", mostly_slow(["plain", "no ending"], 1))
def test_samples_of_every_format_get_one_answer(tmp_path, form, makers, fewest):
    assert len(check_samples(tmp_path, form, makers)) >= fewest


@pytest.mark.slow
@MAKERS
@pytest.mark.parametrize("form", ["mark", "utf-16", "gzip", "wrong ending"])
def test_samples_of_every_format_get_one_answer_in_every_form(tmp_path, form, makers, fewest):
    is_packed_function = form == "gzip" and makers is GUESTS  # functions are not read from gzip
    assert len(check_samples(tmp_path, form, makers)) >= (0 if is_packed_function else fewest)


def check_samples(folder, form, makers):
    """Check that each sample is in a form what it is as it was written, whoever asks; return the kinds."""
    checked = []
    for number, sample in enumerate(samples_by_kind(makers)):
        (folder / f"{number}").mkdir()
        in_form(folder / f"{number}", sample, "plain")
        role = identify(folder / f"{number}" / sample.name).role
        (folder / f"{number}-form").mkdir()
        path = in_form(folder / f"{number}-form", sample, form)
        if path is None:
            continue
        if form == "gzip" and role not in (Role.RECORDING, Role.CALIBRATION):
            with pytest.raises(InputError, match="which is read only if it is not compressed"):
                identify(path)
            continue
        assert answers(path) == (role.value,) * 3, (sample.kind, sample.name)
        checked.append(sample.kind)
    return checked


@pytest.mark.parametrize("name", ["start.xlsx", "start.mat"])
@pytest.mark.parametrize("form", ["gzip", "zip"])
def test_a_binary_calibration_is_one_in_an_archive(tmp_path, name, form):
    ParameterSet([Scalar("Gain", 12.5)]).save(tmp_path / name)
    content, path = (tmp_path / name).read_bytes(), tmp_path / {"gzip": f"{name}.gz", "zip": "start.zip"}[form]
    if form == "gzip":
        path.write_bytes(gzip.compress(content))
    else:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(name, content)
    assert answers(path) == ("calibration",) * 3
    assert kf.read_parameters(path)["Gain"].value == 12.5


def test_a_data_dictionary_is_one_under_another_name(tmp_path):
    with zipfile.ZipFile(tmp_path / "data.bin", "w") as archive:
        archive.writestr("data/chunk0.xml", "<DataSource/>")
    assert identify(tmp_path / "data.bin").format.name == "Simulink data dictionary"


@pytest.mark.parametrize(
    "text",
    [
        "Title = Drive 3\nDate = 2024-01-02\ntime,a\n0,1\n1,2\n2,3\n3,4\n",
        "name=bench;car=7;\ntime;a\n0;1\n1;2\n",
        "Rig = 4\ntime\ta\n0\t1\n1\t2\n2\t3\n",
    ],
)
def test_settings_above_a_table_make_no_formula_and_no_script_of_it(tmp_path, text):
    path = tmp_path / "drive.txt"
    path.write_text(text, encoding="utf-8")
    assert identify(path).format.name == "CSV"
    assert kf.read(path).samples >= 2


def test_the_ending_decides_where_the_content_does_not(tmp_path):
    for name, role in {"net.onnx": "function", "lag.c": "function", "my.py": "function", "Gear.app": "program"}.items():
        (tmp_path / name).write_text("nothing that is known\n", encoding="utf-8")
        assert identify(tmp_path / name).role.value == role


def test_content_overrules_the_ending(tmp_path):
    path = tmp_path / "drive.kf"
    path.write_bytes(b"MDF     4.10" + bytes(200))
    assert identify(path).format.name == "MDF"


@pytest.mark.parametrize(
    "text",
    [
        "<!---->",
        "<!--",
        "<!DOCTYPE[",
        "<?xml ",
        "[",
        "/*",
        "//x\n",
        " \n",
        "\t",
        "; \n",
        '"\n',
        "<!DOCTYPE svg>",
        "classdef A ",
    ],
    ids=repr,
)
def test_repeated_text_is_looked_through_once(tmp_path, text):
    """A pattern that tries all ways to divide such a text never ends."""
    path = tmp_path / "a.m"
    path.write_text(text * (65536 // len(text)), encoding="utf-8")
    assert identify(path).head.path == path
