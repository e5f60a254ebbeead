"""Code that is cut into functions of a few items."""

import pytest

from kennfeld.base.machine_code import engine
from kennfeld.native import emitter


def cut_code(patch: pytest.MonkeyPatch, items: int) -> None:
    """Cut code after so many items. Kept code is left alone: it depends on sources, not on what a test replaces."""
    patch.setattr(emitter, "SEGMENT", items)
    patch.setattr(engine, "read_code", lambda key: None)
    patch.setattr(engine, "keep_code", lambda key, code: None)
