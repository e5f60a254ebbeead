"""Commands on single files: info, convert, diff, merge. Each prints its results and returns an exit status.

What a command needs is imported inside it, so that `kennfeld --help` starts at once.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kennfeld.base.errors import InputError, Location
from kennfeld.base.formatting import count_noun, nearest
from kennfeld.base.garbage_collection import no_collection
from kennfeld.terminal import command_line
from kennfeld.terminal.command_line import DIFFERENT, DONE, PATH, argument, option, require_new
from kennfeld.terminal.model_selection import model_options
from kennfeld.terminal.output import print_findings, print_lines

if TYPE_CHECKING:
    from kennfeld.domain.parameter_set import ParameterSet
    from kennfeld.files.file_format import Reference
    from kennfeld.models.importer import ImportOptions


@click.command
@argument("address", "FILE", "A measurement, calibration, formula, Simulink, ASCET or project file.", type=str)
@command_line.as_json
@option("--search", "Show only entries whose name or description contains TEXT.", "TEXT", default="")
@option("--dbc", "CAN database that decodes a bus log; repeat it for several.", "FILE", multiple=True)
@command_line.description_file
@model_options
def info(address: str, as_json: bool, search: str, dbc: Sequence[str], a2l: Path | None, part: "ImportOptions") -> int:
    """Show the contents of a file.

    --search ignores case; if TEXT contains * or ?, it must match the whole name. For a Simulink model or an
    ASCET project, the output lists what can be calibrated and what prevents it. A file of an object store, such as
    s3://fleet/drive.mf4, is copied for the time of reading. --dbc engine.dbc@1 decodes only channel 1 of the
    logger, and --dbc body.dbc@LIN its LIN frames.
    """
    from kennfeld.terminal.file_info import describe_file, text_lines
    from kennfeld.terminal.label_search import find_entries

    # an FMU may have very many variables, and leaves nothing to collect
    with no_collection() if ".fmu" in address.casefold() else nullcontext():
        with _on_this_machine(address) as path:
            contents = describe_file(path, a2l, part, dbc)
        if search.strip():
            contents = find_entries(contents, search)
        print_lines(*([json.dumps(contents.as_json, indent=2)] if as_json else text_lines(contents)))
    return DONE


@contextmanager
def _on_this_machine(address: str) -> Iterator[Path]:
    """Yield the path of a file, or of the copy of one in an object store."""
    if "://" not in address:
        yield Path(address)
        return
    from kennfeld.preprocessing.recording_sources import find_sources, local_file

    sources = find_sources(Path(), address)
    if len(sources) != 1:
        message = f"matches {len(sources)} files" if sources else "file not found"
        raise InputError.of(Location(address), message, "Name one file.")
    with local_file(sources[0]) as copy:
        yield Path(copy)


@click.command
@argument("source", "IN", "Calibration file or model to read.")
@argument("target", "OUT", "Output file. The extension selects the format.")
@option("--image", "Image or Simulink data dictionary to write the values into.", "FILE", type=PATH)
@option("--changed-since since", "Calibration file: only labels that differ from it are written.", "FILE", type=PATH)
@command_line.description_file
@model_options
@command_line.force
def convert(
    source: Path,
    target: Path,
    image: Path | None,
    since: Path | None,
    a2l: Path | None,
    part: "ImportOptions",
    force: bool,
) -> int:
    """Convert a calibration file, a Simulink model or an ASCET class; write the start values of an FMU.

    Calibration files are .dcm, .csv (INCA CVX), .cdfx, .json, .xlsx (one sheet per table), .m and .mat (MATLAB), and
    .msq, .par, .esdl, .axl and .amd (only over the file they were read from). A model (.slx, .mdl, .esdl, .app, .axl,
    .amd) becomes formula text (.kf), with its parameters in a .json file of the same name.
    """
    from kennfeld import calfiles
    from kennfeld.files import identify
    from kennfeld.models.function_files import split_reference
    from kennfeld.models.importer import ImportRequest
    from kennfeld.models.importer_registry import importer_of_format, updater_of
    from kennfeld.models.model_export import write_formula

    into = identify(str(image)).format if image is not None else None
    update = updater_of(into) if into is not None else ""
    _require_known_ending(target, [".kf", *(into.endings if into is not None and update else ())])
    file, choice = split_reference(str(source))
    known = identify(file).format
    importer, is_formula = importer_of_format(known), target.suffix.lower() == ".kf"
    # a class or an FMU has values of its own, and becomes text only if the ending .kf asks for it
    has_values = known.calibration is not None or (importer is not None and importer.reads)
    becomes_text = importer is not None and (is_formula or not has_values)
    require_new(force, target, *([target.with_suffix(".json")] if becomes_text and is_formula else []))
    if importer is not None and becomes_text:
        paths = write_formula(importer, ImportRequest(Path(file), part, choice), target)
        print_lines(*(f"Written to {path}" for path in paths))
        return DONE
    # start values of a function; a file of several needs the name of one
    if importer is not None and importer.reads and (choice or not importer.named):
        parameters = importer.model(ImportRequest(Path(file), part, choice)).carried
    else:
        [parameters], remarks = calfiles.read_several([source], a2l)
        print_findings(*remarks)
    if since is not None:
        [earlier], remarks = calfiles.read_several([since], a2l)
        print_findings(*remarks)
        everything, parameters = parameters, calfiles.changed(parameters, earlier)
        count = count_noun(len(everything.parameters), "label")
        if not (parameters.parameters or parameters.texts):
            print_lines(f"None of {count} differs from {since}: nothing is written.")
            return DONE
        print_lines(f"{len(parameters.parameters)} of {count} differ from {since}")
    if image is not None and update:
        _write_copy(update, parameters, image, target)
    else:
        print_findings(*calfiles.write(parameters, target, image, a2l), *calfiles.losses(parameters, target))
    print_lines(f"Written to {target}")
    return DONE


def _write_copy(update: "Reference", parameters: "ParameterSet", source: Path, target: Path) -> None:
    """Write a copy of a file with other values."""
    from kennfeld.base.atomic_files import write_whole
    from kennfeld.base.file_errors import convert_errors
    from kennfeld.files.file_format import call

    result = call(update, parameters, source)
    with convert_errors(target, "cannot be written", "Name another file."):
        write_whole(target, result.raw)
    print_findings(*result.findings)


def _require_known_ending(target: Path, others: Sequence[str] = ()) -> None:
    """Raise `InputError` if no format has the ending of a file to write."""
    from kennfeld.calfiles import endings

    known, ending = [*endings(), *others], target.suffix.lower()
    if ending not in known:
        message = f"unknown ending {ending}" if ending else "the name has no ending, which selects the format"
        raise InputError.of(Location(str(target)), message, nearest(ending, known) or f"Known are {', '.join(known)}.")


@click.command
@argument("left", "A", "First calibration file.")
@argument("right", "B", "Second calibration file.")
@option(
    *("--tolerance", "Absolute tolerance, in the unit of the values.", "T", True),
    type=click.FloatRange(0.0),
    default=0.0,
)
@option("--relative", "Relative tolerance.", "R", True, type=click.FloatRange(0.0), default=0.0)
@option("--lab", "Label list to write, with the names that differ.", "FILE", type=PATH)
@command_line.as_json
@command_line.description_file
@command_line.force
def diff(
    left: Path,
    right: Path,
    tolerance: float,
    relative: float,
    lab: Path | None,
    as_json: bool,
    a2l: Path | None,
    force: bool,
) -> int:
    """Compare two calibration files.

    Compares values, axes and units, and lists names in only one of the files. The exit status is 0 if they are equal
    and 1 if they differ.
    """
    from kennfeld import calfiles
    from kennfeld.terminal.diff_lines import difference_lines, file_labels

    if lab is not None:
        require_new(force, lab)
    (first, second), remarks = calfiles.read_several([left, right], a2l)
    print_findings(*remarks)
    comparison = calfiles.compare(first, second, calfiles.Tolerance(tolerance, relative))
    if as_json:
        contents = {
            "left": str(left),
            "right": str(right),
            "equal": comparison.equal,
            "compared": comparison.compared,
            "differences": [difference.as_json for difference in comparison.differences],
        }
        print_lines(json.dumps(contents, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        left_label, right_label = file_labels([left, right])
        print_lines(*difference_lines(comparison, left_label, right_label))
    if lab is not None:
        _write_labels(comparison.labels, lab)
        print_lines(*([] if as_json else ["", f"Written to {lab}"]))
    return DONE if comparison.equal else DIFFERENT


def _write_labels(names: Sequence[str], target: Path) -> None:
    from kennfeld.base.atomic_files import write_whole
    from kennfeld.base.file_errors import convert_errors
    from kennfeld.calfiles.label_list import write_label_list

    text, remarks = write_label_list(names, target.name)
    with convert_errors(target, "cannot be written", "Name another file."):
        write_whole(target, text)
    print_findings(*remarks)


@click.command
@argument("sources", "FILE...", "Calibration files; later files override earlier ones.", nargs=-1, required=True)
@option("-o --output target", "Output file.", "FILE", type=PATH, required=True)
@command_line.description_file
@command_line.force
def merge(sources: Sequence[Path], target: Path, a2l: Path | None, force: bool) -> int:
    """Merge calibration files and list what was replaced or added."""
    from kennfeld import calfiles
    from kennfeld.terminal.diff_lines import change_lines, file_labels

    if len(sources) < 2:
        message = f"needs at least two files, got only {sources[0]}"
        raise InputError.of(Location("merge"), message, "Name another file.")
    _require_known_ending(target)
    require_new(force, target)
    sets, remarks = calfiles.read_several(sources, a2l)
    print_findings(*remarks)
    merged = calfiles.merge(list(zip(file_labels(sources), sets, strict=True)))
    print_findings(*calfiles.write(merged.parameters, target), *calfiles.losses(merged.parameters, target))
    print_lines(*change_lines(merged.changes), "", f"Written to {target}")
    return DONE
