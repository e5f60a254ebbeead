"""A scheduler that requires certificates: joined with the right ones, refused with one message otherwise."""

import shutil
import subprocess
from importlib import import_module
from importlib.util import find_spec

import numpy as np
import pytest

from kennfeld.cli import run
from tests.project.cluster_processes import SIZE, Cluster, calibrate, values_of, write_short
from tests.project.partitioned_projects import in_partitions

pytestmark = [
    pytest.mark.skipif(
        find_spec("distributed") is None, reason="dask.distributed is not installed: pip install kennfeld[cluster]"
    ),
    pytest.mark.skipif(shutil.which("openssl") is None, reason="the program openssl is not installed"),
]

KEYS = ("tls_authority", "tls_certificate", "tls_key")
RIGHT = ("authority.pem", "own.pem", "own-key.pem")
NEW_KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")


def openssl(folder, *arguments):
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)


def make_authority(folder, name):
    """Make a certificate that is signed by itself."""
    files = ("-keyout", f"{name}-key.pem", "-out", f"{name}.pem")
    openssl(folder, "req", "-x509", *NEW_KEY, *files, "-days", "2", "-subj", f"/CN={name}")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """An authority, a certificate that it has signed, and a stranger."""
    folder = tmp_path_factory.mktemp("certificates")
    make_authority(folder, "authority")
    make_authority(folder, "stranger")
    openssl(folder, "req", *NEW_KEY, "-keyout", "own-key.pem", "-out", "own.csr", "-subj", "/CN=127.0.0.1")
    signed = ("-CA", "authority.pem", "-CAkey", "authority-key.pem", "-CAcreateserial")
    openssl(folder, "x509", "-req", "-in", "own.csr", *signed, "-out", "own.pem", "-days", "2")
    return folder


@pytest.fixture(scope="module")
def cluster(certificates):
    authority, certificate, key = (str(certificates / name) for name in RIGHT)
    options = ("--tls-ca-file", authority, "--tls-cert", certificate, "--tls-key", key)
    started = Cluster(certificates, 2, "tls", options)
    files = {"tls_ca_file": authority, "tls_client_cert": certificate, "tls_client_key": key}
    started.wait_for_workers(security=import_module("distributed").Security(**files, require_encryption=True))
    yield started
    started.close()


@pytest.mark.slow
def test_a_calibration_through_tls_gives_the_same_bits(tmp_path, cluster, certificates):
    path = write_short(tmp_path)
    names = dict(zip(KEYS, (str(certificates / name) for name in RIGHT), strict=True))
    remote = calibrate(in_partitions(path, SIZE, scheduler=cluster.address, **names))
    assert np.array_equal(values_of(remote), values_of(calibrate(in_partitions(path, SIZE))))


@pytest.mark.slow
def test_certificates_are_named_relative_to_the_project_file(tmp_path, cluster, certificates, capsys):
    path = write_short(tmp_path)
    for name in RIGHT:
        shutil.copy(certificates / name, tmp_path / name)
    add_cluster(path, cluster.address, RIGHT)
    assert run(["report", "--trust", str(path)]) == 0
    assert f"cluster: 2 workers at {cluster.address}" in capsys.readouterr().err


def errors(capsys):
    """Return the lines on stderr without those on what was allowed."""
    return [line for line in capsys.readouterr().err.splitlines() if not line.startswith("remark: joins")]


def add_cluster(path, address, files):
    lines = [f'{key} = "{name}"\n' for key, name in zip(KEYS, files, strict=True) if name]
    path.write_text(f'{path.read_text()}\n[cluster]\nscheduler = "{address}"\npartition = {SIZE}\n{"".join(lines)}')


@pytest.mark.parametrize(
    ("files", "message", "remedy"),
    [
        (("", "", ""), "requires certificates", "Write tls_authority, tls_certificate, tls_key in [cluster]."),
        (("authority.pem", "", ""), "requires certificates", "tls_key in [cluster]."),
        (("stranger.pem", "own.pem", "own-key.pem"), "TLS certificates do not match", "signed by the authority"),
        (("authority.pem", "stranger.pem", "stranger-key.pem"), "TLS certificates do not match", "signed by"),
        (("authority.pem", "own.pem", "stranger-key.pem"), "TLS certificates do not match", "the key belongs to"),
        (("own.csr", "own.pem", "own-key.pem"), "TLS certificates do not match", "signed by the authority"),
    ],
)
def test_wrong_certificates_are_one_message(tmp_path, cluster, certificates, capsys, files, message, remedy):
    path = write_short(tmp_path)
    add_cluster(path, cluster.address, [str(certificates / name) if name else "" for name in files])
    assert run(["calibrate", "--trust", str(path)]) == 2
    (line,) = errors(capsys)
    assert line.startswith(f"scheduler {cluster.address}: {message}")
    assert remedy in line


def test_missing_certificate_files_are_named(tmp_path, cluster, certificates, capsys):
    path = write_short(tmp_path)
    add_cluster(path, cluster.address, ["gone.pem", str(certificates / "own.pem"), "lost.pem"])
    assert run(["calibrate", "--trust", str(path)]) == 2
    first, second = errors(capsys)
    assert f"[cluster] tls_authority: file {tmp_path / 'gone.pem'} not found" in first
    assert f"[cluster] tls_key: file {tmp_path / 'lost.pem'} not found" in second


def test_certificates_and_an_address_without_tls_contradict_each_other(tmp_path, cluster, certificates, capsys):
    path = write_short(tmp_path)
    add_cluster(path, cluster.address.replace("tls", "tcp"), [str(certificates / name) for name in RIGHT])
    assert run(["calibrate", "--trust", str(path)]) == 2
    (line,) = errors(capsys)
    assert 'Write scheduler = "tls://..."' in line


def test_an_address_without_tls_of_a_scheduler_that_requires_it_is_an_error(tmp_path, cluster, capsys):
    path = write_short(tmp_path)
    add_cluster(path, cluster.address.replace("tls", "tcp"), ("", "", ""))
    assert run(["calibrate", "--trust", str(path)]) == 2
    (line,) = errors(capsys)
    assert "tls:// if it uses TLS" in line
