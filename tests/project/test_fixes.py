"""Fixes of findings: each changes the project file so that the finding is gone, and brings no error."""

import pytest

from kennfeld.base.errors import Finding, Fix, Location
from kennfeld.project.document import ProjectDocument
from tests.project.conftest import Workshop

WITH_MAP = "Predict[Nm] = M(Speed) + offset + 0 * Gain(Speed)\n"


def broken(shop: Workshop, old: str, new: str) -> Workshop:
    """Replace a part of the project file, or add to it if there is none to be replaced."""
    return shop.change(old, new) if old else shop.add(new)


def applied(shop: Workshop, fix: Fix, option: str = "") -> None:
    document = ProjectDocument(shop.toml)
    changes = [*fix.changes]
    if fix.options:
        assert option in fix.options
        changes[-1] = (changes[-1][0], option)
    for keys, value in changes:
        if value is None:
            document.remove(keys)
            document.remove_empty(keys[:-1])
        else:
            document.set(keys, value)
    shop.toml = document.text


def the(findings: list[Finding], message: str) -> Finding:
    own = [finding for finding in findings if message in str(finding)]
    assert own, [*map(str, findings)]
    return own[0]


FIXES = {
    "a misspelt key": ("", "[optimizer]\nstart = 3", "unknown key", "Write starts", ""),
    "an unknown key": ("", "[optimizer]\nzyx = 3", "unknown key", "Remove zyx", ""),
    "a misspelt section": ("", "[optimiser]\nstarts = 3", "unknown section", "Write optimizer", ""),
    "a number as text": (
        "",
        '[optimizer]\nstarts = 2\ntolerance = "0.1"',
        "must be a number",
        "Set tolerance = 0.1",
        "",
    ),
    "a wrong number": ("", "[optimizer]\nstarts = -2", "must be an integer >= 1", "Remove starts", ""),
    "a flag as text": ('bench.csv"]', 'bench.csv"]\ncache = "no"', "must be true or false", "Set cache = false", ""),
    "an unknown word": ('bench.csv"]', 'bench.csv"]\nuse = "trainig"', "unknown value", "Set use", "training"),
    "a key of a contradiction": (
        'target = "Torque"',
        'target = "Torque"\ndelta = 2.0',
        "delta requires",
        "Remove delta",
        "",
    ),
    "an unknown format": (
        '"start.json"',
        '"start.json"\noutput = ["dcm", "cdfxx"]',
        "unknown calibration",
        "Write cdfx",
        "",
    ),
    "a file that is missing": ("bench.csv", "bensch.csv", "matches no file", "Read bench.csv", ""),
    "a dataset that is missing": (
        "[calibration]",
        '[[dataset]]\nfiles = ["gone.csv"]\n\n[calibration]',
        "gone.csv matches no file",
        "Remove dataset 2",
        "",
    ),
    "a function that is missing": ("sensor.kf", "sensr.kf", "does not exist", 'Set file = "sensor.kf"', ""),
    "an initial file that is missing": (
        '"start.json"',
        '["start.json", "gone.json"]',
        "gone.json does not exist",
        "Start without gone.json",
        "",
    ),
    "an input without its channel": ('Speed = "n"', 'Speed = "m"', "has no channel m", "Read Speed from", "n"),
    "an unknown input": ('Speed = "n"', 'Speed = "n"\nLoud = "Load"', "unknown input Loud", "Write Load", ""),
    "an unknown target": ('"Torque"', '"Tork"', "unknown channel or node Tork", "Set target", "Torque"),
    "a parameter without values": ("", "[parameters.Gain]\n[parameters.offst]", "no values", "Set initial = 0.0", ""),
    "a shape of values": ("", "[parameters.offset]\ninitial = [1, 2]", "must be one value", "Set initial = 0.0", ""),
    "bounds in the wrong order": ("", "[parameters.Gain]\nbounds = [5, -5]", "exceeds upper bound", "Swap them", ""),
    "an axis that does not exist": (
        "",
        "[parameters.Gain]\nsmoothness = { x = 1.0, y = 1.0 }",
        "Gain has no axis y",
        "Remove y",
        "",
    ),
    "an unused section": ("", "[parameters.Gaim]\ninitial = 1.0", "does not use Gaim", "Remove Gaim", ""),
    "an unused channel": ("", '[calculated]\nhalf = "n / 2"', "unused channel", "Remove half", ""),
    "a unit of no channel": ("", '[units]\nNone = "rpm"', "channel None is not used", "Remove None", ""),
    "no training data": ('bench.csv"]', 'bench.csv"]\nuse = "test"', "no dataset is used", "Fit bench.csv", ""),
    "nothing free": (
        '"start.json"',
        '"start.json"\nfree = ["Gian"]',
        "Gian matches no parameter",
        "Write Gain",
        "",
    ),
    "a pin of a fixed value": (
        "",
        "[parameters.offset]\nfree = false\npin = [{ at = [], value = 1.0 }]",
        "offset is not free",
        "Free offset",
        "",
    ),
    "weights that are all 0": ('"Torque"', '"Torque"\nweight = 0', "all weights are 0", "Weight Predict by 1", ""),
    "a condition that never holds": (
        'bench.csv"]',
        'bench.csv"]\nwhere = "n > 1e6"',
        "true at no sample",
        "Remove where",
        "",
    ),
    "time in data without it": ('bench.csv"]', 'bench.csv"]\nwarmup = 2', "requires time stamps", "Remove warmup", ""),
    "a shift by a part of a sample": (
        'bench.csv"]',
        'bench.csv"]\nshift = { Torque = 0.4 }',
        "whole samples",
        "Set Torque = 0",
        "",
    ),
}


@pytest.mark.parametrize(("old", "new", "message", "title", "option"), FIXES.values(), ids=FIXES)
def test_a_fix_takes_its_finding_away(
    shop: Workshop, old: str, new: str, message: str, title: str, option: str
) -> None:
    if new.startswith("[parameters.Gain]\n[parameters.offst]"):
        shop.text = "input Speed[rpm]\ninput Load\nPredict[Nm] = Gain(Speed) * Load + offset + offst\n"
    broken(shop, old, new)
    before = shop.findings()
    fixes = {fix.title: fix for fix in the(before, message).fixes}
    assert title in fixes, fixes
    applied(shop, fixes[title], option)
    after = shop.findings()
    assert message not in "\n".join(map(str, after))
    assert [str(finding) for finding in after if finding.severity == "error"] == []


def test_the_fix_of_a_dataset_counts_those_that_are_off(shop: Workshop) -> None:
    shop.change("[[dataset]]", '[[dataset]]\nname = "old"\nfiles = ["bench.csv"]\nuse = "off"\n\n[[dataset]]')
    shop.change('"bench.csv"]\n\n[calibration]', '"bench.csv"]\nuse = "test"\n\n[calibration]')
    applied(shop, the(shop.findings(), "no dataset is used").fixes[0])
    uses = [entry.get("use") for entry in ProjectDocument(shop.toml).get("dataset")]
    assert uses == ["off", None]


def test_an_axis_that_the_data_exceed_is_extended_to_them(shop: Workshop) -> None:
    shop.text = WITH_MAP
    shop.add("[parameters.M]\ninitial = 0\nx = { input = 'Speed', breakpoints = [1200, 1300, 1400] }")
    finding = the(shop.findings(), "outside the axis")
    assert [fix.title for fix in finding.fixes] == ["Extend it to 1000 … 3000"]
    applied(shop, finding.fixes[0])
    assert "outside the axis" not in "\n".join(map(str, shop.findings()))
    assert ProjectDocument(shop.toml).get("parameters", "M", "x", "breakpoints") == [1000, 1300, 3000]


def test_ends_of_a_uniform_axis_are_extended_as_such(shop: Workshop) -> None:
    shop.text = WITH_MAP
    shop.add("[parameters.M]\ninitial = 0\nx = { input = 'Speed', begin = 1200, end = 1400, count = 3 }")
    applied(shop, the(shop.findings(), "outside the axis").fixes[0])
    axis = ProjectDocument(shop.toml).get("parameters", "M", "x")
    assert (axis["begin"], axis["end"], axis["count"]) == (1000, 3000, 3)


def test_an_axis_without_breakpoints_takes_them_from_the_data(shop: Workshop) -> None:
    shop.text = WITH_MAP
    shop.add("[parameters.M]\ninitial = 0\nx = { input = 'Speed' }")
    applied(shop, the(shop.findings(), "the axis has only input").fixes[0])
    assert shop.errors() == []


def test_a_transposed_table_is_turned(shop: Workshop) -> None:
    shop.text = "input Speed[rpm]\ninput Load\nPredict[Nm] = M(Speed, Load) + offset + 0 * Gain(Speed)\n"
    shop.add(
        "[parameters.M]\ninitial = [[1, 2, 3], [4, 5, 6]]\nx = { breakpoints = [1000, 2000, 3000] }\n"
        "y = { breakpoints = [10, 13] }"
    )
    applied(shop, the(shop.findings(), "transposed").fixes[0])
    assert shop.project.problem().parameters["M"].values.tolist() == [[1, 4], [2, 5], [3, 6]]


def test_a_unit_of_another_quantity_can_be_stated(shop: Workshop) -> None:
    shop.bench("bench.csv", **{"n [rpm]": None, "n [Hz]": [1000.0, 1500, 2000, 2500, 3000, 1200]})
    applied(shop, the(shop.findings(), "a different quantity").fixes[0])
    assert shop.findings() == []


def test_removing_an_entry_of_a_list_leaves_the_others(shop: Workshop) -> None:
    shop.add('[[limit]]\nnode = "Predict"\nmax = 1e9\n\n[[limit]]\nnode = "Predict"\nmax = "much"')
    fixes = the(shop.findings(), "must be a number").fixes
    assert [fix.title for fix in fixes] == ["Remove max"]
    shop.change('max = "much"', "mxa = 5")
    assert [fix.title for fix in the(shop.findings(), "unknown key").fixes] == ["Write max", "Remove mxa"]


def test_fixes_do_not_tell_findings_apart() -> None:
    assert Finding(Location("a"), "b") == Finding(Location("a"), "b", fixes=(Fix.remove(("a",)),))
