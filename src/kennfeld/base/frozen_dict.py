"""A dict that cannot be changed, for mappings of frozen values and of results.

`types.MappingProxyType` is one, too, but it can be neither pickled nor copied, nor written as JSON.
"""

from typing import Any, NoReturn, TypeVar

K = TypeVar("K")  # Python 3.11
V = TypeVar("V")


class FrozenDict(dict[K, V]):
    """A dict without the methods that change one.

    >>> units = FrozenDict({"Speed": "rpm"})
    >>> units["Speed"]
    'rpm'
    >>> units["Torque"] = "Nm"
    Traceback (most recent call last):
        ...
    TypeError: this mapping cannot be changed; dict(...) makes a copy that can
    """

    __slots__ = ()

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("this mapping cannot be changed; dict(...) makes a copy that can")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type["FrozenDict[K, V]"], tuple[dict[K, V]]]:
        return type(self), (dict(self),)
