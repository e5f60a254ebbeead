"""Archives that unpack to far more than they weigh are recognised before anybody unpacks them."""

import zipfile
from io import BytesIO

import pytest

from kennfeld.base.archives import find_oversized, most_unpacked, with_members
from kennfeld.base.errors import InputError
from kennfeld.files.limited_stream import limited


def packed(path, content, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive, archive.open("sheet.xml", "w", force_zip64=True) as member:
        for chunk in content:
            member.write(chunk)
    return path


def fault(path):
    with zipfile.ZipFile(path) as archive:
        return find_oversized(archive)


BOMB = [bytes(1_000_000)] * (most_unpacked(100_000) // 1_000_000 + 1)


def test_a_member_that_unpacks_to_a_hundred_times_its_size_is_refused(tmp_path):
    assert fault(packed(tmp_path / "a.zip", BOMB)).startswith("sheet.xml holds 42 MB or more, packed into 0.0 MB")


@pytest.mark.parametrize("content", [[b"<c>12.5</c>" * 1000], [bytes(range(256)) * 100], [bytes(1_000_000)]])
def test_usual_members_are_fine(tmp_path, content):
    assert fault(packed(tmp_path / "a.zip", content)) == ""


def test_a_large_member_that_is_not_packed_is_fine(tmp_path):
    assert fault(packed(tmp_path / "a.zip", BOMB, zipfile.ZIP_STORED)) == ""


def test_a_member_that_hides_its_size_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 400)
    path = packed(tmp_path / "a.zip", [bytes(10_000)] * 2000)
    with zipfile.ZipFile(path) as archive:
        member = archive.infolist()[0]
        member.file_size = member.compress_size
        assert find_oversized(archive).startswith("sheet.xml holds ")


def test_a_member_that_claims_to_be_longer_than_the_file_or_is_garbled_comes_to_an_end(tmp_path):
    path = packed(tmp_path / "a.zip", [bytes(range(256)) * 10_000])
    with zipfile.ZipFile(path) as archive:
        member = archive.infolist()[0]
        member.compress_size = member.file_size = 10**12
        assert find_oversized(archive).startswith("its members hold 1000000 MB, packed into ")
        member.file_size, member.header_offset = 10**6, -26 + 7  # where no packed data begin
        assert find_oversized(archive) == ""


def test_a_workbook_that_claims_more_texts_than_it_has_room_for_is_refused(tmp_path):
    for count, message in ((3, ""), (10**9, "xl/sharedStrings.xml claims to hold 1000000000 texts")):
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            archive.writestr("xl/sharedStrings.xml", f'<sst count="3" uniqueCount="{count}"><si><t>a</t></si></sst>')
        assert fault(tmp_path / "a.zip") == message


def test_members_that_share_their_packed_bytes_are_reported_together(tmp_path, monkeypatch):
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 400)
    path = packed(tmp_path / "a.zip", [bytes(900_000)])
    with zipfile.ZipFile(path) as archive:
        assert find_oversized(archive) == ""
        archive.filelist *= 2
        assert find_oversized(archive).startswith("its members hold 2 MB, packed into 0.0 MB")


def test_a_stream_ends_in_a_finding_at_its_limit(monkeypatch):
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 4000)
    most = most_unpacked(1000)
    with limited(BytesIO(bytes(most)), "drive.csv.gz", 1000) as stream:
        assert len(stream.read()) == most
    beyond = limited(BytesIO(bytes(most + 1)), "drive.csv.gz", 1000)
    with pytest.raises(InputError, match=r"^drive\.csv\.gz: its 0\.001 MB unpack to more than 0 MB, 101 times"), beyond:
        beyond.read()


def test_a_copy_with_other_contents_of_a_member_keeps_all_else():
    raw = BytesIO()
    with zipfile.ZipFile(raw, "w") as archive:
        archive.comment = b"of a tool"
        for name, method in (("a", zipfile.ZIP_STORED), ("b", zipfile.ZIP_DEFLATED)):
            archive.writestr(zipfile.ZipInfo(name, (2001, 2, 3, 4, 5, 6)), f"old {name}", method)
    with zipfile.ZipFile(BytesIO(with_members(raw.getvalue(), {"b": b"new"}))) as archive:
        assert (archive.read("a"), archive.read("b"), archive.comment) == (b"old a", b"new", b"of a tool")
        methods = [(member.compress_type, member.date_time[0]) for member in archive.infolist()]
    assert methods == [(zipfile.ZIP_STORED, 2001), (zipfile.ZIP_DEFLATED, 2001)]
