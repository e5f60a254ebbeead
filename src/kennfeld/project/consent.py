"""Requests of a project for the consent of the user: the code that it runs, and the addresses that it uses.

They are found from the project file without running code, connecting, or writing.
"""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from kennfeld.base.dask_runner import ClusterAddress, scheduler_address
from kennfeld.base.errors import InputError
from kennfeld.base.file_state import while_unchanged
from kennfeld.base.output_paths import is_below
from kennfeld.models.code_consent import ConsentRequest, address_request, code_request
from kennfeld.models.function_files import importer_of_function, read_function_file, split_reference
from kennfeld.models.model_function import as_model
from kennfeld.preprocessing.recording_sources import is_remote, store_of
from kennfeld.project.schema import ProjectFile


def consent_requests(file: ProjectFile, text: str | None = None) -> tuple[ConsentRequest, ...]:
    """Return what a project asks for, whether or not it has been allowed; each file and address once.

    Args:
        file: the project file. Its problem is not built, because that can evaluate nodes.
        text: the formula text; functions whose names it does not contain are not called. None reads it.
    """
    requests = (*_code(file, _formula(file) if text is None else text), *_folders(file), *_stores(file))
    return tuple({request.digest: request for request in requests}.values())


def scheduler_request(file: ProjectFile, address: ClusterAddress | None) -> ConsentRequest | None:
    """Return the request to join the scheduler of a project; None if it joins none, or names a file without one."""
    if address is None or not address.scheduler:
        return None
    with suppress(InputError):
        return address_request("scheduler", scheduler_address(address), file.location("cluster", "scheduler"))
    return None


def _formula(file: ProjectFile) -> str | None:
    """Return the formula text of a project; None if its function is something else, or cannot be read."""
    name = file.model.file
    if not name.lower().endswith(".kf"):
        return None
    with suppress(OSError, ValueError):
        return file.unsaved.get(name) or (file.folder / name).read_text("utf-8")
    return None


def _code(file: ProjectFile, text: str | None) -> Iterator[ConsentRequest]:
    for name, reference in _references(file, text):
        importer = importer_of_function(reference)
        if importer is None or not importer.runs or not _runs(file, name, reference):
            continue
        location = file.location("functions", name) if name else file.location("model", "file")
        request = code_request(file.folder / split_reference(reference)[0], location)
        if request is not None:
            yield request


def _references(file: ProjectFile, text: str | None) -> Iterator[tuple[str, str]]:
    """Yield the functions that may be called, by name; the function of the project has none."""
    if importer_of_function(file.model.file) is not None:
        yield "", file.model.file
        return
    # a name in the text need not be a call: to ask for too much is safe, to ask for too little is not
    yield from ((name, each) for name, each in file.functions.items() if text is None or name in text)


def _runs(file: ProjectFile, name: str, reference: str) -> bool:
    """Return True if code of a file runs with a function; False if it is translated, or cannot be read."""
    importer, path = importer_of_function(reference), file.folder / split_reference(reference)[0]
    if importer is None or not importer.translated:
        return path.is_file()
    with suppress(OSError, InputError):
        return _is_called(path, reference, str(file.folder), name)
    return False


@while_unchanged(64)
def _is_called(path: Path, reference: str, folder: str, name: str) -> bool:
    """Return True if code of a function in a file runs. Raises `InputError`, or `OSError` if there is no file."""
    path.stat()
    graph = as_model(read_function_file(reference, Path(folder), name)).graph
    return any(node.op == "external" for node in graph.nodes)


def _folders(file: ProjectFile) -> Iterator[ConsentRequest]:
    folder = Path(file.cluster.folder)
    if file.cluster.partition_size and not is_below(file.folder, file.folder / folder):
        yield address_request("folder", str(folder), file.location("cluster", "folder"))


def _stores(file: ProjectFile) -> Iterator[ConsentRequest]:
    for entry in file.datasets:
        for pattern in (*entry.files, *entry.database_files):
            store = store_of(pattern) if is_remote(pattern) else ""
            if store:
                yield address_request("store", store, entry.location.within("files"))
