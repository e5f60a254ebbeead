"""A demo that cannot be written, or prepared, leaves nothing."""

from pathlib import Path

import pytest

from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.project.demo import all_or_none, write, writing


def fail_at(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    original = writing.write_whole

    def fail(path: Path, *content: object) -> None:
        if path.name == name:
            raise OSError(28, "No space left on device")
        original(path, *content)  # type: ignore[arg-type]

    monkeypatch.setattr(writing, "write_whole", fail)


@pytest.mark.parametrize("existing", ["", "deep", "deep/demo"])
def test_a_full_disk_leaves_no_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, existing: str) -> None:
    (tmp_path / existing).mkdir(parents=True, exist_ok=True)
    fail_at("bench.csv", monkeypatch)
    with pytest.raises(InputError, match="the demo cannot be written: No space left"):
        write("torque", tmp_path / "deep/demo")
    assert {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")} == {
        *filter(None, ["deep" if existing else "", existing])
    }


def test_an_existing_demo_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write("torque", tmp_path / "demo")
    (tmp_path / "demo" / "bench.csv").unlink()
    before = sorted(path.name for path in (tmp_path / "demo").iterdir())
    fail_at("bench.csv", monkeypatch)
    with pytest.raises(InputError):
        write("torque", tmp_path / "demo")
    assert sorted(path.name for path in (tmp_path / "demo").iterdir()) == before


def test_a_folder_of_the_user_stays(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError):
        write("torque", tmp_path)
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_a_demo_that_cannot_be_prepared_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("kennfeld.project.demo.prepare", fail)
    assert cli.run(["demo", "torque", "--dir", str(tmp_path / "demo")]) == 130
    assert not list(tmp_path.iterdir())


def test_a_demo_that_succeeds_stays(tmp_path: Path) -> None:
    with all_or_none(tmp_path / "demo"):
        (tmp_path / "demo").mkdir()
    assert (tmp_path / "demo").is_dir()
