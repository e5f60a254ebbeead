"""Pickles that other processes read, also of the read-only mappings in models that importers of others make."""

import copyreg
import io
import pickle
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any


def pickle_content(content: Any) -> bytes:
    """Pickle content that may contain the read-only mappings of a model."""
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL)
    pickler.dispatch_table = copyreg.dispatch_table | {MappingProxyType: _reduce_proxy}
    pickler.dump(content)
    return stream.getvalue()


def _reduce_proxy(proxy: Mapping[Any, Any]) -> tuple[Callable[..., Any], tuple[dict[Any, Any]]]:
    return _read_only, (dict(proxy),)


def _read_only(mapping: dict[Any, Any]) -> Mapping[Any, Any]:
    return MappingProxyType(mapping)  # the type itself cannot be pickled
