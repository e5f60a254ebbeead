"""Names of machines in FMI, and the endings of their shared libraries."""

import platform
import sys

LIBRARY_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
SUFFIXES = {"windows": ".dll", "darwin": ".dylib", "linux": ".so"}  # by system in the names of FMI 3.0


def platform_tuple() -> str:
    """Name this machine as FMI 3.0 does: x86_64-linux, aarch64-darwin."""
    machine = platform.machine().lower()
    architecture = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    return f"{architecture}-{ {'win32': 'windows', 'darwin': 'darwin'}.get(sys.platform, 'linux') }"


def platform_folder(version: str, machine: str = "") -> str:
    """Name the folder of libraries for this machine, or for one named as in FMI 3.0.

    >>> platform_folder("2.0", "x86_64-windows"), platform_folder("2.0", "aarch64-linux")
    ('win64', 'linux-aarch64')
    """
    machine = machine or platform_tuple()
    if version == "3.0":
        return machine
    # FMI 2.0 names linux64, win64 or darwin64, and no other architecture
    architecture, _, system = machine.partition("-")
    name = {"windows": "win"}.get(system, system)
    if architecture == "x86_64":
        return f"{name}64"
    return f"{name}-{'arm64' if (system, architecture) == ('darwin', 'aarch64') else architecture}"
