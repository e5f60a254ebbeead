"""Tables as the bytes of a file state them, by parsers that share nothing with those of the package.

Each returns by table the breakpoints of its axes in the order of the file, and the values by their coordinates.
"""

import csv
import json
import re
from itertools import product
from xml.etree import ElementTree

import numpy as np
import python_calamine
from scipy.io import loadmat


def _pair(axes, value_at):
    """Pair every place of a table with its value; `value_at` takes the positions in the file."""
    places = product(*(range(len(axis)) for axis in axes))
    return axes, {tuple(axis[i] for axis, i in zip(axes, at, strict=True)): value_at(*at) for at in places}


def stored_in_dcm(path):
    tables, name, rows, axes = {}, "", [], {}
    for line in path.read_text(encoding="utf-8").splitlines():
        word, *rest = line.split()[:1] + line.split()[1:] if line.strip() else [""]
        if word.startswith(("KENNLINIE", "KENNFELD", "GRUPPENKENN")):
            name, rows, axes = rest[0], [], {"x": [], "y": []}
        elif word == "ST/X" and name:
            axes["x"] += map(float, rest)
        elif word == "ST/Y" and name:
            axes["y"] += map(float, rest)
        elif word == "WERT" and name:
            rows += map(float, rest)
        elif word == "END" and name:
            stored_axes, width = [axis for axis in axes.values() if axis], len(axes["x"])
            tables[name] = _pair(stored_axes, lambda i, j=0, rows=rows, width=width: rows[j * width + i])
            name = ""
    return tables


def stored_in_cvx(path):
    rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    points, tables = {}, {}
    for (first, _), line in zip(enumerate(rows), rows, strict=True):
        kind = line[0] if line else ""
        if kind.endswith("AXIS_PTS"):
            points[kind, rows[first - 1][1]] = list(map(float, line[2:]))
    for first, line in enumerate(rows):
        if not line or line[0] not in ("CURVE", "MAP"):
            continue
        name, groups = rows[first - 1][1], [*line[1:], "", ""]
        axes = [
            points["AXIS_PTS", group] if group else points[f"{letter}_AXIS_PTS", name]
            for letter, group in zip("X" if line[0] == "CURVE" else "XY", groups, strict=False)
        ]
        begin = first + (1 if line[0] == "CURVE" else 2)
        numbers = [
            list(map(float, row[2:])) for row in rows[begin : begin + len(axes[-1]) if len(axes) > 1 else begin + 1]
        ]
        tables[name] = _pair(axes, lambda i, j=0, numbers=numbers: numbers[j][i])
    return tables


def stored_in_cdfx(path):
    tree = ElementTree.fromstring(re.sub(r"<!DOCTYPE[^>]*>", "", path.read_text(encoding="utf-8")))
    instances = list(tree.iter("SW-INSTANCE"))

    def nested(element):
        groups = element.findall("VG")
        return [nested(group) for group in groups] if groups else [float(v.text) for v in element.findall("V")]

    common = {i.findtext("SHORT-NAME"): i for i in instances if i.findtext("CATEGORY") == "COM_AXIS"}
    tables = {}
    for instance in instances:
        axes = []
        for axis in instance.iter("SW-AXIS-CONT"):
            reference = axis.findtext("SW-INSTANCE-REF")
            axes.append(nested(next((common[reference] if reference else axis).iter("SW-VALUES-PHYS"))))
        if axes:
            values = np.array(nested(instance.find("SW-VALUE-CONT/SW-VALUES-PHYS"))).T
            tables[instance.findtext("SHORT-NAME")] = _pair(axes, lambda *at, values=values: float(values[at]))
    return tables


def stored_in_script(path):
    text = path.read_text(encoding="utf-8")
    fields = {}
    for name, field, value in re.findall(r"^(\w+)\.(\w+) = ([^;]*);", text, re.MULTILINE):
        fields.setdefault(name, {})[field] = value

    def numbers(value):
        if "." in value and re.fullmatch(r"\w+\.x", value):
            value = fields[value[:-2]]["x"]
        return list(map(float, re.sub(r"[\[\],\n]|reshape\(|\.\.\.|\)", " ", value).split()))

    tables = {}
    for name, own in fields.items():
        axes = [numbers(own[letter]) for letter in "xyzw" if letter in own]
        if "values" not in own:
            continue
        shape = tuple(map(len, axes))
        if own["values"].startswith("reshape"):
            values = np.array(numbers(own["values"])[: np.prod(shape)]).reshape(shape, order="F")
        else:
            values = np.array(numbers(own["values"])).reshape(shape)
        tables[name] = _pair(axes, lambda *at, values=values: float(values[at]))
    return tables


def stored_in_mat(path):
    tables = {}
    for name, struct in loadmat(path, squeeze_me=False, struct_as_record=True).items():
        if isinstance(struct, np.ndarray) and struct.dtype.names and "values" in struct.dtype.names:
            own = struct[0, 0]
            axes = [own[letter].ravel().tolist() for letter in "xyzw" if letter in struct.dtype.names]
            values = own["values"].reshape(tuple(map(len, axes)), order="F")
            tables[name] = _pair(axes, lambda *at, values=values: float(values[at]))
    return tables


def stored_in_excel(path):
    book = python_calamine.CalamineWorkbook.from_path(str(path))
    tables = {}
    for sheet in book.sheet_names:
        rows = book.get_sheet_by_name(sheet).to_python(skip_empty_area=False)
        corners = [at for at, row in enumerate(rows) if str(row[0]).startswith(("x right", "y down"))]
        if not corners or sheet in ("Parameters", "Scalars", "Texts", "Axes"):
            continue
        x = [point for point in rows[corners[0]][1:] if point != ""]
        is_map = str(rows[corners[0]][0]).startswith("y down")
        below = rows[corners[0] + 1 :]
        y = []
        for row in below:
            if not is_map or not isinstance(row[0], float):
                break
            y.append(row[0])
        z = [rows[at - 1][1] for at in corners] if str(rows[corners[0] - 1][0]) == "z" else []
        axes = [x, *([y] if is_map else []), *([z] if z else [])]
        tables[sheet] = _pair(axes, lambda i, j=0, k=0, rows=rows, corners=corners: rows[corners[k] + 1 + j][1 + i])
    return tables


def stored_in_json(path):
    tables = {}
    for name, entry in json.loads(path.read_text(encoding="utf-8")).items():
        axes = [entry[letter] for letter in "xyzw" if letter in entry]
        if entry["kind"] in ("curve", "map", "cube"):
            values = np.array(entry["values"])
            pairs = _pair(axes, lambda *at, values=values: float(values[at]))[1]
            tables[name] = (
                [
                    points[:: -1 if entry.get(f"{letter}_falling") else 1]
                    for letter, points in zip("xyzw", axes, strict=False)
                ],
                pairs,
            )
    return tables


STORED_IN = {
    ".dcm": stored_in_dcm,
    ".csv": stored_in_cvx,
    ".cdfx": stored_in_cdfx,
    ".m": stored_in_script,
    ".mat": stored_in_mat,
    ".xlsx": stored_in_excel,
    ".json": stored_in_json,
}
