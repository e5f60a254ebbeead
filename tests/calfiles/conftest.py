import warnings
from pathlib import Path

import pytest

from kennfeld.base.errors import InputWarning

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


@pytest.fixture
def shared_data():
    """The folder of real files from public sources; it is not part of the repository."""
    if not SHARED.is_dir():
        pytest.skip(f"the real files are not here: {SHARED}")
    return SHARED


@pytest.fixture
def written(tmp_path):
    """Write a text to a file and give its path."""

    def write(text, name="start.dcm", encoding="utf-8"):
        path = tmp_path / name
        path.write_bytes(text.encode(encoding))
        return path

    return write


@pytest.fixture(autouse=True)
def without_input_warnings():
    """Let files with skipped parts be read: what is skipped is tested by the findings of `describe`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        yield
