"""Machine code that calls the functions of an instance of an FMU, records each call, and renews the instance."""

from collections.abc import Sequence

from kennfeld.base.machine_code.call_record import write_begin
from kennfeld.base.machine_code.external import c_pointer
from kennfeld.base.machine_code.ir import FunctionWriter
from kennfeld.importers.fmu.number_access import NumberGroup

WARNING, DISCARD, ERROR, FATAL, PENDING = 1, 2, 3, 4, 5  # status of a call; up to a warning, it has succeeded
REUSED = "reused"  # memory: 1 if a reset makes an instance as new, see `reset_check`; 0 if only another one is


class InstanceCalls:
    """Calls of the functions of an instance; the worst status is kept in memory.

    Args:
        f: the function under construction.
        version: `2.0` or `3.0`.
        prefix: begin of the names of memory and functions of the FMU.
        functions: names of the functions in the order of their numbers in records of calls.
        place: register that holds the address at which the pointer of the instance is kept; it is null for none.
        record: register that holds the address of a slot of the record of calls.
        worst: address of the worst status.
    """

    def __init__(
        self,
        f: FunctionWriter,
        version: str,
        prefix: str,
        functions: Sequence[str],
        place: str,
        record: str,
        worst: str,
    ) -> None:
        self.f, self.prefix, self.functions = f, prefix, functions
        self.place, self.record, self.worst = place, record, worst
        self.second, self.standard = version == "2.0", f"fmi{version[0]}"
        # fmi2Boolean is an int, fmi3Boolean the bool of C
        self.false = "i32 0" if self.second else "i1 zeroext false"

    def memory(self, name: str) -> str:
        """Return the address of memory of the FMU, or of a function of its library."""
        return c_pointer(self.f, f"{self.prefix}_{name}")

    def function(self, name: str) -> str:
        """Record the call of a function of the library that follows, and return its address."""
        write_begin(self.f, self.record, self.functions.index(name) + 1)
        return self.memory(name)

    def __call__(self, name: str, *arguments: str) -> None:
        """Call a function with the instance and arguments; without an instance, its status is that of a fatal error."""
        f = self.f
        status = f.variable("i32", str(FATAL))
        instance = f.load(self.place, kind="ptr")
        # an FMU may refuse to replace an instance, such as without a license; a call without one would crash
        with f.when(f.new(f"icmp ne ptr {instance}, null")):
            function = self.function(f"{self.standard}{name}")
            status.set(f.new(f"call i32 {function}({', '.join((f'ptr {instance}', *arguments))})"))
        worst = f.load(self.worst, kind="i32")
        worse = f.new(f"icmp sgt i32 {status.get()}, {worst}")
        f.store(f.new(f"select i1 {worse}, i32 {status.get()}, i32 {worst}"), self.worst, kind="i32")

    def set(self, group: NumberGroup, values: str) -> None:
        """Set variables to the values at an address."""
        self._access("Set", group, values)

    def get(self, group: NumberGroup, values: str) -> None:
        """Write the values of variables to an address."""
        self._access("Get", group, values)

    def _access(self, verb: str, group: NumberGroup, values: str) -> None:
        # FMI 3.0 passes the number of values as well, which arrays make larger than that of references
        lengths = () if self.second else (f"i64 {group.size}",)
        references = f"ptr {self.memory(group.name)}", f"i64 {group.references}"
        self(f"{verb}{group.type.access}", *references, f"ptr {values}", *lengths)

    def renew(self, running: str, create: str, arguments: Sequence[str]) -> None:
        """Make the instance as new: reset it if that works, otherwise replace it.

        Args:
            running: an i1 that is true if the instance was initialized, without an error since.
            create: name of the function that creates an instance.
            arguments: its arguments.
        """
        f = self.f
        reused = f.new(f"icmp ne i64 {f.load(self.memory(REUSED), kind='i64')}, 0")
        instance = f.load(self.place, kind="ptr")
        with f.when(f.new(f"icmp ne ptr {instance}, null")):
            # the standards allow a reset and the end of an instance at any time, but tools are tested with those that
            # come after the end of a simulation; others free the memory of a solver twice, or not at all
            with f.when(running):
                self("Terminate")
            f.store("0", self.worst, kind="i32")
            with f.when(reused):
                self("Reset")
            fine = f.new(f"icmp slt i32 {f.load(self.worst, kind='i32')}, {DISCARD}")
            # the old one goes before the new one comes: an FMU may allow one instance at a time
            with f.unless(reused, fine):
                f.do(f"call void {self.function(f'{self.standard}FreeInstance')}(ptr {instance})")
                f.store("null", self.place, kind="ptr")
        with f.when(f.new(f"icmp eq ptr {f.load(self.place, kind='ptr')}, null")):
            f.store(self.create(create, arguments), self.place, kind="ptr")

    def create(self, function: str, arguments: Sequence[str]) -> str:
        """Return the address of a new instance, or null."""
        return self.f.new(f"call ptr {self.function(function)}({', '.join(arguments)})")

    def creation_arguments(self) -> tuple[str, str, str, str]:
        """Return the arguments that all functions that create an instance take: name, token, resources, callbacks."""
        name, token, resources, log = (f"ptr {self.memory(part)}" for part in ("name", "token", "resources", "log"))
        return name, token, resources, log
