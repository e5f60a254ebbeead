"""Where a file keeps the variables of its model workspace."""

import numpy as np

from kennfeld.models.simulink.files.package import Package
from kennfeld.models.simulink.files.section import Section
from kennfeld.models.simulink.files.settings import setting
from kennfeld.models.simulink.files.tree import Workspace
from kennfeld.models.simulink.files.trouble import Trouble

__all__ = ["workspace_of"]

_MXARRAYS = ("simulink/modelWorkspace.mxarray", "simulink/modelworkspace.mxarray")
_MATS = ("simulink/modelWorkspace.mat", "simulink/modelworkspace.mat")


def workspace_of(model: Section, package: Package | None, sections: list[Section], trouble: Trouble) -> Workspace:
    """The model workspace: in a part of the package, in a section beside the model, as code, or in another file."""
    source = setting(model, "WSDataSource")
    code = setting(model, "WSMATLABCode") or setting(model, "WSMCode")
    if "Code" in source and code.strip():
        return Workspace("m-code", text=code)
    name = setting(model, "WSSourceFileName") or setting(model, "WSDataSourceFile")
    if "MAT" in source and "Code" not in source and name:
        return Workspace("file", text=name)
    return _packed(package) if package is not None else _encoded(model, sections, trouble)


def _packed(package: Package) -> Workspace:
    for name in _MXARRAYS:
        raw = package.raw(name)
        if raw:
            return Workspace("mxarray", raw)
    for name in _MATS:
        raw = package.raw(name)
        if raw:
            return Workspace("mat", raw)
    return Workspace()


def _encoded(model: Section, sections: list[Section], trouble: Trouble) -> Workspace:
    """The record of MatData that the model names; four characters above the blank stand for three bytes."""
    tag = setting(model, "WSMdlFileData")
    if not tag:
        return Workspace()
    records = [part for section in sections if section.kind == "MatData" for part in section.all("DataRecord")]
    record = next((part for part in records if part.keys.get("Tag") == tag), None)
    if record is None:
        trouble.remark(f"the model workspace is in {tag[:60]}, which the file does not hold")
        return Workspace()
    return Workspace("mxarray", _bytes(record.keys.get("Data", "")))


def _bytes(text: str) -> bytes:
    """The bytes of a text of 6 bits a character, the blank being 0; the back quote stands for the blank."""
    characters = np.frombuffer(text.encode("latin-1", "replace"), dtype=np.uint8)
    sixes = ((characters - 32) & 63).astype(np.uint32)
    sixes = sixes[: sixes.size // 4 * 4].reshape(-1, 4)
    words = sixes[:, 0] << 18 | sixes[:, 1] << 12 | sixes[:, 2] << 6 | sixes[:, 3]
    return np.stack([words >> 16 & 255, words >> 8 & 255, words & 255], axis=1).astype(np.uint8).tobytes()
