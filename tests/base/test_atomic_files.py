import errno
import os
import re
import stat

import pytest

from kennfeld.base.atomic_files import replace_atomically, write_whole

posix = pytest.mark.skipif(os.name != "posix", reason="permissions and links as POSIX has them")


def mode_of(path):
    return stat.S_IMODE(path.stat().st_mode)


def names_in(folder):
    return [path.name for path in folder.iterdir()]


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old", encoding="utf-8")
    return path


def test_a_file_is_written_as_utf_8_without_leftovers(tmp_path):
    write_whole(tmp_path / "a.txt", "µ\n", durable=True)
    assert (tmp_path / "a.txt").read_bytes() == b"\xc2\xb5\n"
    assert names_in(tmp_path) == ["a.txt"]


def test_a_write_protected_file_is_refused_and_stays(file):
    file.chmod(0o444)
    with pytest.raises(PermissionError, match="it is write-protected"):
        write_whole(file, "new")
    assert file.read_text(encoding="utf-8") == "old"
    assert names_in(file.parent) == ["a.txt"]


@posix
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664, 0o755])
def test_a_replaced_file_keeps_its_permissions(file, mode):
    file.chmod(mode)
    write_whole(file, "new")
    assert (file.read_text(encoding="utf-8"), mode_of(file)) == ("new", mode)


@posix
def test_a_new_file_has_the_permissions_of_any_other(tmp_path):
    (tmp_path / "plain.txt").write_text("", encoding="utf-8")
    write_whole(tmp_path / "a.txt", "new")
    assert mode_of(tmp_path / "a.txt") == mode_of(tmp_path / "plain.txt")


@posix
def test_nobody_reads_the_new_content_who_could_not_read_the_old(file):
    file.chmod(0o600)
    with replace_atomically(file) as beside:
        assert mode_of(beside) == 0o600
        beside.write_text("new", encoding="utf-8")


@posix
@pytest.mark.skipif(os.name == "posix" and os.geteuid() != 0, reason="only root gives files away")
def test_a_replaced_file_keeps_its_owner_if_the_system_allows(file):
    os.chown(file, 1234, 1235)
    write_whole(file, "new")
    assert (file.stat().st_uid, file.stat().st_gid) == (1234, 1235)


@posix
@pytest.mark.parametrize("exists", [True, False])
def test_a_link_stays_a_link_to_the_file_that_is_written(file, exists):
    link = file.with_name("link.txt")
    link.symlink_to("a.txt")
    if not exists:
        file.unlink()
    write_whole(link, "new", follow=True)
    assert link.is_symlink()
    assert file.read_text(encoding="utf-8") == "new"


@posix
def test_a_link_to_a_write_protected_file_is_refused(file):
    file.chmod(0o444)
    file.with_name("link.txt").symlink_to("a.txt")
    with pytest.raises(PermissionError):
        write_whole(file.with_name("link.txt"), "new", follow=True)


@posix
def test_links_in_a_circle_are_an_error_of_the_system(tmp_path):
    link = tmp_path / "link.txt"
    link.symlink_to(link.name)
    with pytest.raises(OSError, match=re.escape(os.strerror(errno.ELOOP))):
        write_whole(link, "new", follow=True)
    assert link.is_symlink()


@posix
@pytest.mark.parametrize("target", ["a.txt", "missing.txt", "link.txt"])
def test_a_link_that_nobody_follows_is_replaced(file, target):
    link = file.with_name("link.txt")
    link.symlink_to(target)
    write_whole(link, "new")
    assert (link.is_symlink(), link.read_text(encoding="utf-8")) == (False, "new")
    assert sorted(names_in(file.parent)) == [file.name, link.name]
    assert file.read_text(encoding="utf-8") == "old"


@pytest.mark.parametrize("length", [30, 255])
def test_a_name_may_have_any_length(tmp_path, length):
    path = tmp_path / ("x" * (length - 4) + ".txt")
    write_whole(path, "new")
    assert path.read_text(encoding="utf-8") == "new"


@posix
def test_other_hard_links_keep_the_old_content(file):
    other = file.with_name("other.txt")
    os.link(file, other)
    write_whole(file, "new")
    assert (file.read_text(encoding="utf-8"), other.read_text(encoding="utf-8")) == ("new", "old")


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(OSError, match="it is a folder or a device, not a file"):
        write_whole(tmp_path, "new")


@posix
def test_a_pipe_is_refused_and_stays(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="not a file"):
        write_whole(tmp_path / "pipe", "new")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_a_block_that_fails_leaves_the_old_file(file):
    with pytest.raises(ZeroDivisionError), replace_atomically(file) as beside:
        beside.write_text(f"half {1 / 0}", encoding="utf-8")
    assert file.read_text(encoding="utf-8") == "old"
    assert names_in(file.parent) == ["a.txt"]


def test_remains_of_a_killed_process_are_ignored(file):
    with replace_atomically(file) as beside:
        pass
    file.write_text("old", encoding="utf-8")
    beside.write_text("left", encoding="utf-8")
    write_whole(file, "new")
    beside.unlink()
    assert (file.read_text(encoding="utf-8"), names_in(file.parent)) == ("new", ["a.txt"])


@posix
@pytest.mark.parametrize("mode", [None, 0o644])
def test_a_private_file_is_readable_by_its_owner_only(file, mode):
    if mode is None:
        file.unlink()
    else:
        file.chmod(mode)
    write_whole(file, "secret", private=True)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert file.read_text(encoding="utf-8") == "secret"
