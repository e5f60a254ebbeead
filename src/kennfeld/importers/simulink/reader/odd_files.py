"""Files under the name of a Simulink model that hold something else, or nothing that can be read."""

from pathlib import Path

from kennfeld.base.errors import InputError, Location
from kennfeld.files.foreign import OLE, identify_foreign, identify_package
from kennfeld.files.functions import PROTECTED

EXTENSION_REMEDY = "Simulink files end in .slx or .mdl."
PROTECTED_MODEL = ("is a protected model, whose blocks cannot be read", "Ask its supplier for the unprotected model.")
_OLE = "an OLE package: either the model is encrypted by rights management, or it is a document of another program"


def odd_file_error(raw: bytes, path: Path) -> InputError:
    """Return the error that says what a file holds that is not a Simulink model."""
    return InputError.of(Location(path.name), *_description(raw, path))


def _description(raw: bytes, path: Path) -> tuple[str, str]:
    """Return message and remedy."""
    if not raw.strip():
        return "is empty", "Copy it again, or save the model again."
    foreign = identify_foreign(raw)
    if foreign is None and raw.startswith(OLE):
        foreign = identify_package(raw)
        if foreign is None or foreign.description.startswith("an OLE package"):
            return f"is {_OLE}", "Save the model without encryption."
    if path.suffix.casefold() in PROTECTED.endings:
        return PROTECTED_MODEL
    if foreign is not None:
        return f"is {foreign.description}, not a Simulink file", foreign.remedy
    return "is not a Simulink file", EXTENSION_REMEDY
