"""Archives that unpack to far more than they weigh are recognised before anybody unpacks them."""

import zipfile

import pytest

from kennfeld.archives import LARGE, find_oversized


def packed(path, content, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive, archive.open("sheet.xml", "w", force_zip64=True) as member:
        for chunk in content:
            member.write(chunk)
    return path


def fault(path):
    with zipfile.ZipFile(path) as archive:
        return find_oversized(archive)


BOMB = [bytes(1_000_000)] * (LARGE // 1_000_000 + 1)


def test_a_member_that_unpacks_to_a_hundred_times_its_size_is_told(tmp_path):
    assert fault(packed(tmp_path / "a.zip", BOMB)).startswith("sheet.xml holds 101 MB or more, packed into 0.1 MB")


@pytest.mark.parametrize("content", [[b"<c>12.5</c>" * 1000], [bytes(range(256)) * 100], [bytes(1_000_000)]])
def test_usual_members_are_fine(tmp_path, content):
    assert fault(packed(tmp_path / "a.zip", content)) == ""


def test_a_large_member_that_is_not_packed_is_fine(tmp_path):
    assert fault(packed(tmp_path / "a.zip", BOMB, zipfile.ZIP_STORED)) == ""


def test_a_member_that_hides_its_size_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("kennfeld.archives.LARGE", 1_000_000)
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
        assert find_oversized(archive) == ""
        member.header_offset = -26 + 7  # where no packed data begin
        assert find_oversized(archive) == ""


def test_a_workbook_that_claims_more_texts_than_it_has_room_for_is_told(tmp_path):
    for count, said in ((3, ""), (10**9, "xl/sharedStrings.xml claims to hold 1000000000 texts")):
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            archive.writestr("xl/sharedStrings.xml", f'<sst count="3" uniqueCount="{count}"><si><t>a</t></si></sst>')
        assert fault(tmp_path / "a.zip") == said
