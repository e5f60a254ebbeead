"""Name of this machine in FMI, and the ending of its shared libraries."""

import platform
import sys

LIBRARY_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def platform_folder(version: str) -> str:
    """Name the folder of libraries for this machine."""
    machine = platform.machine().lower()
    if version == "3.0":
        # FMI 3.0 names x86_64-linux or aarch64-darwin; FMI 2.0 linux64, win64 or darwin64
        architecture = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
        return f"{architecture}-{ {'win32': 'windows', 'darwin': 'darwin'}.get(sys.platform, 'linux') }"
    name = {"win32": "win", "darwin": "darwin"}.get(sys.platform, "linux")
    return f"{name}64" if machine in ("amd64", "x86_64") else f"{name}-{machine}"
