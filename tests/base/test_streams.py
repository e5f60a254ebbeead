import io

import kennfeld as kf
from kennfeld.base.streams import local_file, stream_name


def test_recordings_and_calibrations_are_read_from_streams(tmp_path):
    data = kf.read(io.BytesIO(b"time [s],Speed [rpm]\n0,1000\n1,1500\n"))
    assert data["Speed"].values.tolist() == [1000, 1500]
    assert data.files.names == ("stream",)
    assert kf.read(io.StringIO("Speed [rpm]\n1000\n")).samples == 1
    path = tmp_path / "start.dcm"
    kf.ParameterSet([kf.Scalar("K", 0.5)]).save(path)
    with path.open("rb") as stream:
        values = kf.read_parameters(stream)
    assert values["K"].value == 0.5
    values.save(tmp_path / "again.dcm")
    assert kf.read_parameters(tmp_path / "again.dcm")["K"].value == 0.5


def test_a_copy_of_a_stream_does_not_outlast_its_reading(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("Speed\n1\n")
    with path.open("rb") as stream, local_file(stream) as copy:
        assert copy != path
        assert copy.name == stream_name(stream) == "bench.csv"
    assert not copy.exists()
