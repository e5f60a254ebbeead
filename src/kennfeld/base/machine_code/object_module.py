"""A module of machine code, as it is kept on disk."""

import json
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from kennfeld.base.machine_code.external import External

_SIZE = 4  # bytes that give the length of the head


class ObjectModule(NamedTuple):
    """An object file, with what is needed to call its functions.

    Attributes:
        code: the object file.
        functions: the types of the parameters (`ptr` or `i64`) of each function.
        externals: the functions that it calls through pointers.
    """

    code: bytes
    functions: Mapping[str, Sequence[str]]
    externals: Sequence[External]

    def to_bytes(self) -> bytes:
        """Return the content of a file.

        >>> module = ObjectModule(b"code", {"run": ["ptr", "i64"]}, [External("", "exp"), External("a.b", "f", (2,))])
        >>> ObjectModule.of_bytes(module.to_bytes()) == module
        True
        """
        head = json.dumps([dict(self.functions), self.externals]).encode()
        return len(head).to_bytes(_SIZE, "little") + head + self.code

    @classmethod
    def of_bytes(cls, content: bytes) -> "ObjectModule":
        """Return the module of what `to_bytes` returned."""
        end = _SIZE + int.from_bytes(content[:_SIZE], "little")
        functions, externals = json.loads(content[_SIZE:end])
        return cls(content[end:], functions, [External(module, name, tuple(args)) for module, name, args in externals])
