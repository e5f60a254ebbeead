import pytest

from kennfeld.base.errors import InputError
from kennfeld.base.formatting import one_line
from kennfeld.calfiles.format import CalibrationSource, FileFindings

TEXT = 'FESTWERT K\n EINHEIT_W "°C"\n'


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_the_encoding_is_detected(encoding):
    assert CalibrationSource("a", TEXT.encode(encoding)).text == TEXT


def test_the_encoding_that_a_file_declares_counts():
    text = '* encoding="cp1251"\nГрад\n'
    assert CalibrationSource("a", text.encode("cp1251")).text == text


@pytest.mark.parametrize("name", ["zip", "unicode_escape", "nonsense", "utf-99", "undefined"])
def test_a_declared_encoding_of_an_unknown_name_is_ignored(name):
    text = f'* encoding="{name}"\n°\n'
    assert CalibrationSource("a", text.encode()).text == text


def test_bytes_that_no_encoding_knows_are_still_read():
    assert CalibrationSource("a", b"\x81\xff").text == "\x81\xff"


def test_lines_end_in_a_line_feed_whatever_the_file_uses():
    assert CalibrationSource("a", b"a\r\nb\rc\n").text == "a\nb\nc\n"


def test_notes_settle_in_the_order_of_the_file():
    findings = FileFindings("a.dcm")
    findings.error(9, "K", "wrong", "Mend it.", "  K 9  ")
    findings.warning(5, "", "odd")
    findings.error(2, "", "worse")
    with pytest.raises(InputError) as caught:
        findings.finish()
    assert str(caught.value) == "a.dcm line 2: worse\na.dcm line 9 (K): wrong. Mend it."
    assert caught.value.findings[1].excerpt == "K 9"


def test_remarks_alone_refuse_nothing():
    findings = FileFindings("a.dcm")
    findings.warning(0, "K", "odd")
    assert [(str(warning), warning.severity) for warning in findings.finish()] == [("a.dcm K: odd", "warning")]


def test_a_text_becomes_one_line():
    assert one_line("a\nb\tc") == "a b c"
