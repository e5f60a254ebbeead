"""What text files leave open: points that may separate thousands, and encodings that are guessed."""

import gzip

import pytest

from kennfeld.files.encoding import detect_encoding
from kennfeld.measurement import describe, read

GERMAN = "Drehzahl [1/min];Last [%]\n950;10\n1.100;20\n1.250;30\n980;40\n"


def test_a_point_that_may_separate_thousands_is_warned_of(csv):
    data = read(csv(GERMAN))
    assert data["Drehzahl"].values.tolist() == [950, 1.1, 1.25, 980]
    (remark,) = data.findings
    assert remark.severity == "warning"
    assert str(remark) == (
        "bench.csv line 3, column Drehzahl: 1.100 is read as 1.1, but may mean 1100: other cells have no point. "
        "If it means 1100, export the file without thousands separators; if not, ignore this."
    )
    assert describe(csv(GERMAN)).tables[0].findings == data.findings


def test_a_doubtful_number_is_detected_in_packed_files_and_beyond_the_first_lines(csv):
    rows = "950;10\n" * 20_000
    data = read(csv(gzip.compress(f"n;Last\n{rows}1.100;20\n".encode()), "run.csv.gz"))
    assert [str(remark.location) for remark in data.findings] == ["run.csv.gz line 20002, column n"]


@pytest.mark.parametrize(
    "text",
    [
        GERMAN.replace("20", "20.5"),  # another column shows what a point is
        GERMAN.replace("1.250", "1.25"),
        GERMAN.replace("980", "1980"),  # would be 1.980
        GERMAN.replace("950", "0.950"),
        "a;b\n1.100;2\n1.250;3\n2.000;4\n",  # three digits throughout
        "a;b\n1;2\n2;3\n3;4\n",
        GERMAN.replace(";", ","),
        "a;b\n1.100,5;2\n950,5;3\n2.000,5;4\n",  # the comma is the decimal mark
    ],
)
def test_points_that_are_clear_are_not(csv, text):
    assert read(csv(text)).findings == ()


@pytest.mark.parametrize(
    ("names", "encoding", "expected"),
    [
        ("时间 [s],转速 [rpm],扭矩 [Nm],排气温度 [℃]", "gbk", "gb18030"),
        ("时间,发动机转速,水温（℃）", "gb18030", "gb18030"),
        ("時間 [s],回転数 [rpm],トルク [Nm],水温 [℃]", "cp932", "cp932"),
        ("時間,ｶｲﾃﾝ,ﾄﾙｸ,エンジン回転数", "cp932", "cp932"),
        ("Zeit [s],Größe [m³],Öltemperatur [°C],Übersetzung", "cp1252", "cp1252"),
        ("Größe;Maß;süß", "cp1252", "cp1252"),
        ("temps;débit;créées;température [°C]", "cp1252", "cp1252"),
        ("Temp – °C;“Speed”;µs", "cp1252", "cp1252"),
        ("时间,转速,°C", "utf-8", "utf-8"),
        ("plain", "ascii", "utf-8"),
    ],
)
def test_the_encoding_is_the_one_whose_characters_are_likely(names, encoding, expected):
    assert detect_encoding(names.encode(encoding), True) == expected
    assert detect_encoding(names.encode(encoding)[:-1], False) == expected


@pytest.mark.parametrize(("encoding", "message"), [("gbk", "GB18030 (Chinese)"), ("cp932", "Shift JIS (Japanese)")])
@pytest.mark.parametrize("bulk", [True, False])
def test_a_chinese_or_japanese_file_is_read_with_a_remark(csv, monkeypatch, encoding, message, bulk):
    if bulk:
        monkeypatch.setattr("kennfeld.measurement.text.BULK", 0)
    names = {"gbk": "时间 [s],转速 [rpm],排气温度 [℃]", "cp932": "時間 [s],回転数 [rpm],水温 [℃]"}[encoding]
    data = read(csv(f"{names}\n" + "".join(f"{k},{900 + k},{k}\n" for k in range(300)), encoding=encoding))
    _, speed, temperature = (part.split(" ")[0] for part in names.split(","))
    assert data[speed].unit == "rpm"
    assert data[temperature].unit == "℃"
    (remark,) = data.findings
    assert remark.severity == "remark"
    assert message in str(remark)


def test_western_files_are_read_without_a_remark(csv):
    assert read(csv("Zeit [s];Öl [°C]\n0;1\n1;2\n", encoding="cp1252")).findings == ()
