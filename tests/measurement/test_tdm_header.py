"""TDM with its binary file: blocks, records, implicit and scaled columns, damage."""

import zipfile

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies, refusals

HEAD = """<?xml version="1.0" encoding="UTF-8" standalone="no" ?>
<usi:tdm xmlns:usi="http://www.ni.com/Schemas/USI/1_0" version="1.0">
  <usi:include><file byteOrder="littleEndian" url="C:\\old\\bench.tdx">{blocks}</file></usi:include>
  <usi:data>{data}</usi:data>
</usi:tdm>
"""


def channel(number, name, unit, column, values=""):
    own, local, sequence = f"usi{number}0", f"usi{number}1", f"usi{number}2"
    return (
        f'<tdm_channel id="{own}"><name>{name}</name><unit_string>{unit}</unit_string>'
        f'<local_columns>#xpointer(id("{local}"))</local_columns></tdm_channel>'
        f'<localcolumn id="{local}"><submatrix>#xpointer(id("usi900"))</submatrix>{column}'
        f'<values>#xpointer(id("{sequence}"))</values></localcolumn>'
        f'<double_sequence id="{sequence}">{values}</double_sequence>'
    )


def block(number, **attributes):
    text = " ".join(f'{key}="{value}"' for key, value in attributes.items())
    return f'<block id="inc{number}" {text}/>'


def group(name, *channels):
    ids = " ".join(f'id("usi{number}0")' for number in channels)
    return (
        f'<tdm_channelgroup id="usi8{name}"><name>{name}</name><channels>#xpointer({ids})</channels></tdm_channelgroup>'
    )


EXPLICIT = "<sequence_representation>explicit</sequence_representation>"
ROWS = '<submatrix id="usi900"><number_of_rows>3</number_of_rows></submatrix>'


def parameters(kind, *numbers):
    text = f"<generation_parameters>{' '.join(map(str, numbers))}</generation_parameters>"
    return f"<sequence_representation>{kind}</sequence_representation>{text}"


@pytest.fixture
def tdm(tmp_path):
    def write(blocks, data, binary):
        path = tmp_path / "bench.tdm"
        path.write_text(HEAD.format(blocks=blocks, data=data + ROWS), encoding="utf-8")
        (tmp_path / "bench.tdx").write_bytes(binary)
        return path

    return write


def test_implicit_time_and_explicit_channels_are_read(tdm):
    values = np.array([900.0, 950.0, 1000.0]).tobytes() + np.array([1, 2, 3], dtype="<i2").tobytes()
    path = tdm(
        block(0, byteOffset=0, length=3, valueType="eFloat64Usi")
        + block(1, byteOffset=24, length=3, valueType="eInt16Usi"),
        group("bench", 1, 2, 3)
        + channel(1, "Time", "s", parameters("implicit_linear", 0.5, 0.1))
        + channel(2, "Speed", "rpm", EXPLICIT, '<values external="inc0"/>')
        + channel(3, "Raw", "V", parameters("raw_linear", 10.0, 0.5), '<values external="inc1"/>'),
        values,
    )
    data = read(path)
    np.testing.assert_allclose(data.time, [0.5, 0.6, 0.7])
    assert (data["Speed"].values.tolist(), data["Speed"].unit) == ([900.0, 950.0, 1000.0], "rpm")
    assert data["Raw"].values.tolist() == [10.5, 11.0, 11.5]
    assert describe(path).kind == "TDM"


def test_records_for_each_sample_are_read(tdm):
    records = np.array([(1, 10.0), (2, 20.0), (3, 30.0)], dtype=[("a", "u1"), ("b", "<f8")])
    blocks = "".join(
        f'<block_bm id="inc{i}" blockOffset="{at}" blockSize="9" byteOffset="0" length="3" valueType="{kind}"/>'
        for i, (at, kind) in enumerate([(0, "eUInt8Usi"), (1, "eFloat64Usi")])
    )
    data = group("bench", 1, 2)
    data += channel(1, "a", "", EXPLICIT, '<values external="inc0"/>')
    data += channel(2, "b", "", EXPLICIT, '<values external="inc1"/>')
    read_back = read(tdm(blocks, data, records.tobytes()))
    assert read_back["a"].values.tolist() == [1.0, 2.0, 3.0]
    assert read_back["b"].values.tolist() == [10.0, 20.0, 30.0]


@pytest.mark.parametrize("inline", [True, False])
def test_start_and_step_may_be_written_as_values(tdm, inline):
    path = tdm(
        block(0, byteOffset=0, length=2, valueType="eFloat64Usi")
        + block(1, byteOffset=16, length=3, valueType="eFloat64Usi"),
        group("bench", 1, 2)
        + channel(
            1,
            "Time",
            "[s]",
            "<sequence_representation>implicit_linear</sequence_representation>",
            "<values>0.5 0.1</values>" if inline else '<values external="inc0"/>',
        )
        + channel(2, "Speed", "rpm", EXPLICIT, '<values external="inc1"/>'),
        np.array([0.5, 0.1, 900.0, 950.0, 1000.0]).tobytes(),
    )
    data = read(path)
    np.testing.assert_allclose(data.time, [0.5, 0.6, 0.7])
    assert data["Speed"].values.tolist() == [900.0, 950.0, 1000.0]


def test_a_description_packed_by_diadem_is_read(tdm):
    data = group("bench", 1) + channel(1, "Speed", "[rpm]", EXPLICIT, '<values external="inc0"/>')
    path = tdm(block(0, byteOffset=0, length=3, valueType="eFloat64Usi"), data, np.arange(3.0).tobytes())
    description = path.read_bytes()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("header.xml", description)
    assert read(path)["Speed"].values.tolist() == [0.0, 1.0, 2.0]
    assert (describe(path).kind, read(path)["Speed"].unit) == ("TDM", "rpm")
    assert refusals(path, head=4, count=300) > 200


def stamps(seconds, order="<"):
    """Times of LabVIEW, with an origin of its own."""
    fields = [("fraction", "<u8"), ("seconds", "<i8")] if order == "<" else [("seconds", ">i8"), ("fraction", ">u8")]
    stamped = np.zeros(len(seconds), fields)
    stamped["seconds"] = 3_750_417_468 + np.floor(seconds).astype(np.int64)
    stamped["fraction"] = (np.mod(seconds, 1) * 2.0**64).astype(np.uint64)
    return stamped.tobytes()


@pytest.mark.parametrize(("order", "word"), [("<", "littleEndian"), (">", "bigEndian")])
def test_dates_of_all_groups_count_from_the_earliest(tdm, order, word):
    blocks = block(0, byteOffset=0, length=3, valueType="eTimeUsi")
    blocks += block(1, byteOffset=48, length=3, valueType="eTimeUsi")
    data = group("early", 1, 2) + group("late", 3, 4)
    data += channel(1, "Time", "", EXPLICIT, '<values external="inc0"/>')
    data += channel(2, "Speed", "rpm", parameters("implicit_linear", 0, 100))
    data += channel(3, "Time", "", EXPLICIT, '<values external="inc1"/>')
    data += channel(4, "Torque", "Nm", parameters("implicit_linear", 0, 10))
    raw = stamps(np.array([0.75, 1.75, 2.75]), order) + stamps(np.array([1.25, 2.25, 3.25]), order)
    path = tdm(blocks, data, raw)
    path.write_text(path.read_text().replace("littleEndian", word))
    assert read(path, ["Speed"]).time.tolist() == [0.0, 1.0, 2.0]
    both = read(path, ["Speed", "Torque"], raster=0.5)
    assert both.time.tolist() == [1.0, 1.5, 2.0]
    assert both["Torque"].values.tolist() == [5.0, 10.0, 15.0]
    assert both["Speed"].values.tolist() == [100.0, 150.0, 200.0]


def flagged(flags):
    flagged = channel(1, "Speed", "", EXPLICIT, '<values external="inc0"/>')
    flagged = flagged.replace("<values>#", '<flags>#xpointer(id("usi13"))</flags><values>#')
    return flagged + f'<short_sequence id="usi13"><values external="{flags}"/></short_sequence>'


def test_values_with_flags_may_be_missing(tdm):
    blocks = block(0, byteOffset=0, length=3, valueType="eFloat64Usi")
    blocks += block(1, byteOffset=24, length=3, valueType="eInt16Usi")
    raw = np.arange(3.0).tobytes() + np.array([15, 0, 9], dtype="<i2").tobytes()
    path = tdm(blocks, group("bench", 1) + flagged("inc1"), raw)
    np.testing.assert_array_equal(read(path)["Speed"].values, [0.0, np.nan, 2.0])
    with pytest.raises(InputError, match="the flags of its values are fewer than the values, or not integers"):
        read(tdm(blocks, group("bench", 1) + flagged("inc0"), raw))


@pytest.mark.parametrize(
    ("column", "message"),
    [
        (parameters("raw_polynomial", 2, 0, 1, 3), "values of the representation raw_polynomial cannot be read"),
        (parameters("implicit_saw", 0, 1, 3), "values of the representation implicit_saw cannot be read"),
        (parameters("implicit_linear", 0), "start and step are not stated"),
    ],
)
def test_representations_that_cannot_be_read_are_named(tdm, column, message):
    data = group("bench", 1) + channel(1, "Speed", "", column, '<values external="inc0"/>')
    with pytest.raises(InputError, match=f"channel Speed: .*{message}"):
        read(tdm(block(0, byteOffset=0, length=1, valueType="eTimeUsi"), data, bytes(16)))


def test_groups_are_distinguished(tdm):
    data = group("left", 1) + group("right", 2)
    data += channel(1, "Speed", "", EXPLICIT, '<values external="inc0"/>')
    data += channel(2, "Speed", "", EXPLICIT, '<values external="inc0"/>')
    path = tdm(block(0, byteOffset=0, length=2, valueType="eFloat64Usi"), data, np.array([1.0, 2.0]).tobytes())
    assert [table.name for table in describe(path).tables] == ["left", "right"]
    assert read(path, ["right/Speed"])["right/Speed"].values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"length": 99}, "file bench.tdx is cut off"),
        ({"valueType": "eOther"}, "values of type eOther cannot be read"),
        ({"length": 10**12}, "it claims 1000000000000 values"),
        ({"byteOffset": -8}, "an impossible place"),
    ],
)
def test_errors_are_reported_with_the_channel(tdm, attributes, message):
    stated = {"byteOffset": 0, "length": 2, "valueType": "eFloat64Usi"} | attributes
    data = group("bench", 1) + channel(1, "Speed", "", EXPLICIT, '<values external="inc0"/>')
    with pytest.raises(InputError, match=f"channel Speed: .*{message}"):
        read(tdm(block(0, **stated), data, np.array([1.0, 2.0]).tobytes()))


def test_entities_in_two_bytes_a_character_are_refused(tdm):
    path = tdm("", "", b"")
    text = path.read_text().replace("UTF-8", "UTF-16").replace("<usi:tdm", '<!DOCTYPE a [<!ENTITY b "c">]><usi:tdm')
    path.write_bytes(text.encode("utf-16"))
    with pytest.raises(InputError):
        read(path)


def test_entities_are_refused(tmp_path):
    path = tmp_path / "bench.tdm"
    path.write_text('<?xml version="1.0"?><!-- --><tdm>'.replace("<tdm>", "<tdm>&a;<!DOCTYPE a></tdm>"))
    with pytest.raises(InputError, match="declares a document type or entities"):
        read(path)


@few_or_many_copies
def test_damaged_descriptions_are_read_or_refused(tdm, count):
    data = group("bench", 1, 2) + channel(1, "Time", "s", parameters("implicit_linear", 0.0, 0.1))
    data += channel(2, "Speed", "", EXPLICIT, '<values external="inc0"/>')
    path = tdm(block(0, byteOffset=0, length=3, valueType="eFloat64Usi"), data, np.arange(3.0).tobytes())
    assert refusals(path, head=60, count=count, bytes_=b'0123456789-."<>/ aeiou', raster=0.1) > count / 3
