"""Recordings in object stores: addresses of fsspec, through checks, descriptions and calibrations."""

import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.cli import run
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.preprocessing.recording_sources import find_addresses, find_sources, local_file
from kennfeld.project import Project
from kennfeld.report.provenance import sources
from tests.draws import mostly_slow
from tests.project.cluster_processes import FIXED, SHORT, SIZE, calibrate, values_of, write_short
from tests.project.partitioned_projects import STEADY, in_partitions, write_steady

fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed: pip install kennfeld[cluster]")

PARTITIONS = f"\n[cluster]\npartition = {SIZE}\n"


def write_stored(folder: Path, protocol: str = "file", text: str = FIXED + SHORT + PARTITIONS) -> Path:
    """Write a project whose recordings are addresses of a store."""
    path = write_steady(folder, files=2, samples=250, text=text)
    store = f"{protocol}://{folder}" if protocol != "memory" else "memory://fleet"
    if protocol == "memory":
        for file in folder.glob("*.csv"):
            fsspec.filesystem("memory").pipe(f"/fleet/{file.name}", file.read_bytes())
            file.unlink()
    lines = path.read_text().replace('files = ["', f'files = ["{store}/')
    path.write_text(lines)
    return path


@pytest.fixture(autouse=True)
def empty_memory():
    fsspec.filesystem("memory").store.clear()
    yield
    fsspec.filesystem("memory").store.clear()


@pytest.fixture(params=mostly_slow(["file", "local", "memory"], ["memory"]))
def stored(request, tmp_path):
    return write_stored(tmp_path, request.param)


def test_sums_are_those_of_local_files(stored, tmp_path_factory):
    local = in_partitions(write_short(tmp_path_factory.mktemp("local")), SIZE)
    ours, theirs = (CompiledProblem(project.problem()) for project in (Project.read(stored), local))
    assert np.array_equal(ours.start, theirs.start)
    assert ours.sums.cost(ours.start * 1.01) == theirs.sums.cost(ours.start * 1.01)


@pytest.mark.slow
def test_a_calibration_ends_at_the_values_of_local_files(stored, tmp_path_factory):
    local = in_partitions(write_short(tmp_path_factory.mktemp("local")), SIZE)
    assert np.array_equal(values_of(calibrate(Project.read(stored))), values_of(calibrate(local)))


@pytest.mark.slow
def test_check_and_calibrate_run_from_the_command_line(stored, capsys):
    assert run(["check", str(stored)]) == 0
    assert "training samples in 4 partitions" in capsys.readouterr().out
    assert run(["calibrate", str(stored)]) == 1  # max_iterations
    assert (stored.parent / "results" / "report.html").is_file()
    files = {file.name: file for file in sources(Project.read(stored))}
    (bench,) = (file for name, file in files.items() if name.endswith("bench_0.csv"))
    assert (bench.role, bench.digest) == ("data, training", "")
    assert bench.size > 5_000


def test_info_describes_a_file_of_a_store(tmp_path, capsys):
    path = write_stored(tmp_path)
    assert run(["info", f"file://{path.parent}/bench_0.csv"]) == 0
    assert "4 channels over 250 samples" in capsys.readouterr().out
    assert run(["info", f"file://{path.parent}/bench_*.csv"]) == 2
    assert "matches 2 files. Name one file." in capsys.readouterr().err
    assert run(["info", f"file://{path.parent}/none.csv"]) == 2
    assert f"file://{path.parent}/none.csv: file not found" in capsys.readouterr().err


@pytest.mark.slow
def test_other_processes_read_addresses(tmp_path, shared_cluster):
    path = write_stored(tmp_path)
    remote = calibrate(in_partitions(path, SIZE, scheduler=shared_cluster.address))
    assert np.array_equal(values_of(remote), values_of(calibrate(Project.read(path))))


def test_patterns_match_files_in_the_order_of_their_names(tmp_path):
    for name in ("b2.csv", "b10.csv", "a.csv", "c.txt"):
        (tmp_path / name).write_text("x\n1\n")
    (tmp_path / "folder.csv").mkdir()
    names = [source.name for source in find_sources(tmp_path, f"file://{tmp_path}/*.csv")]
    assert names == ["a.csv", "b10.csv", "b2.csv"]
    assert [s.name for s in find_sources(tmp_path, f"file://{tmp_path}/b?.csv")] == ["b2.csv"]
    assert find_addresses(tmp_path, f"file://{tmp_path}/a.csv") == [f"file://{tmp_path}/a.csv"]


@pytest.mark.parametrize("name", ["gone.csv", "gone_*.csv"])
@pytest.mark.parametrize("protocol", ["file", "memory"])
def test_a_missing_file_is_named(tmp_path, name, protocol, capsys):
    path = write_stored(tmp_path, protocol, STEADY.replace("road.csv", name) + PARTITIONS)
    assert run(["check", str(path)]) == 2
    err = capsys.readouterr().err
    assert f"/{name} matches no file" in err
    assert f"{protocol}://" in err


def test_a_missing_package_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "s3fs", None)
    path = write_steady(tmp_path, text=STEADY.replace("bench_*", "s3://fleet/bench_*") + PARTITIONS)
    assert run(["check", "--trust", str(path)]) == 2
    remark, line = capsys.readouterr().err.splitlines()
    assert remark.startswith("remark: reads files from s3://fleet")
    assert line.startswith("s3://fleet/bench_*.csv: cannot be read (")
    assert "Install s3fs where Kennfeld runs, also on the workers." in line


def test_an_unknown_protocol_is_named(tmp_path):
    with pytest.raises(InputError, match=r"orbit://fleet/a\.csv: cannot be read \(.*orbit.*Check the protocol"):
        find_sources(tmp_path, "orbit://fleet/a.csv")


@pytest.mark.parametrize(
    "address",
    ["reference://a.json", "dask://a.csv", "simplecache::file:///a.csv", "zip://a.csv::https://fleet/a.zip", "dir://a"],
)
def test_addresses_that_combine_others_or_run_code_are_refused(tmp_path, address):
    with pytest.raises(InputError, match="not an address of one file or pattern"):
        find_sources(tmp_path, address)


def test_a_store_needs_consent_before_a_connection(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fsspec.core.url_to_fs", lambda address: pytest.fail(f"{address} was reached"))
    path = write_steady(tmp_path, text=STEADY.replace("bench_*", "s3://stranger/bench_*") + PARTITIONS)
    for command in ("check", "simulate", "calibrate", "report"):
        assert run([command, str(path)]) == 2
        message = "[[dataset]] 1 files: reads files from s3://stranger, and has not been allowed to."
        assert message in capsys.readouterr().err
    assert run(["info", str(path)]) == 0


def test_stores_are_read_only_in_partitions(tmp_path, capsys):
    path = write_stored(tmp_path, text=STEADY)
    assert run(["check", str(path)]) == 2
    assert "Object stores are read in partitions: write partition in [cluster]." in capsys.readouterr().err


def test_a_changed_file_is_read_again(stored):
    before = Project.read(stored).problem().partitions.samples
    (address,) = find_addresses(stored.parent, Project.read(stored).file.datasets[0].files[0].replace("*", "1"))
    system, path = fsspec.core.url_to_fs(address)
    lines = system.cat(path).decode().splitlines()
    system.pipe(path, "\n".join(lines[:-90]).encode())
    assert Project.read(stored).problem().partitions.samples == before - 90


def test_a_file_of_the_same_size_with_another_time_counts_as_changed(tmp_path):
    (tmp_path / "a.csv").write_text("x\n1\n")
    (before,) = find_sources(tmp_path, f"file://{tmp_path}/a.csv")
    os.utime(tmp_path / "a.csv", (1, 1))
    (after,) = find_sources(tmp_path, f"file://{tmp_path}/a.csv")
    assert after.state != before.state
    with pytest.raises(InputError, match=r"a\.csv: has changed since it was listed"), local_file(before):
        pass


def test_a_file_that_is_missing_during_reading_is_named(tmp_path):
    (tmp_path / "a.csv").write_text("x\n1\n")
    (source,) = find_sources(tmp_path, f"file://{tmp_path}/a.csv")
    (tmp_path / "a.csv").unlink()
    with pytest.raises(InputError, match=r"a\.csv: there is no such file"), local_file(source):
        pass


class _Store:
    """A store that says the same about a file in different words, as listings and single requests do."""

    def __init__(self, **facts):
        self.facts = facts

    def invalidate_cache(self):
        pass

    def glob(self, path, detail):
        return {"bucket/a.csv": {"type": "file", **self.facts}}

    def info(self, path):
        return {**self.facts, "ContentType": "text/csv", "LastModified": "today"}


@pytest.mark.parametrize("facts", [{"size": 3, "ETag": '"abc"', "LastModified": 5}, {"size": 3, "md5Hash": "x"}])
def test_the_state_of_a_file_does_not_depend_on_the_kind_of_request(tmp_path, monkeypatch, facts):
    monkeypatch.setattr("kennfeld.preprocessing.recording_sources._open_store", lambda address: (_Store(**facts), "a*"))
    (listed,) = find_sources(tmp_path, "s3://bucket/a*.csv")
    monkeypatch.setattr("kennfeld.preprocessing.recording_sources._open_store", lambda address: (_Store(**facts), "a"))
    (asked,) = find_sources(tmp_path, "s3://bucket/a.csv")
    assert asked.state == listed.state


def test_a_store_that_refuses_is_one_message(tmp_path, monkeypatch):
    class Closed(_Store):
        def info(self, path):
            raise PermissionError("Access Denied")

    monkeypatch.setattr("kennfeld.preprocessing.recording_sources._open_store", lambda address: (Closed(), "a"))
    with pytest.raises(InputError, match=r"s3://bucket/a: cannot be listed \(Access Denied\). Check the address"):
        find_sources(tmp_path, "s3://bucket/a")


def test_copies_are_removed_after_reading(tmp_path, monkeypatch):
    folder = tmp_path / "copies"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    (tmp_path / "a.csv").write_text("x\n1\n")
    (source,) = find_sources(tmp_path, f"file://{tmp_path}/a.csv")
    with local_file(source) as copy:
        assert Path(copy).is_relative_to(folder)
        shutil.copy(copy, tmp_path / "seen.csv")
    assert list(folder.iterdir()) == []
    assert (tmp_path / "seen.csv").read_text() == "x\n1\n"
