"""CDFX as tools write it: variants, cascades, references, and what is refused."""

import random

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, read, write
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar
from kennfeld.domain.texts import Text

HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
FRAME = (
    "<MSRSW{space}><CATEGORY>CDF20</CATEGORY><SW-SYSTEMS><SW-SYSTEM><SW-INSTANCE-SPEC><SW-INSTANCE-TREE>\n"
    "{instances}</SW-INSTANCE-TREE></SW-INSTANCE-SPEC></SW-SYSTEM></SW-SYSTEMS></MSRSW>\n"
)


def numbers(*values):
    return f"<SW-VALUES-PHYS>{''.join(f'<V>{value}</V>' for value in values)}</SW-VALUES-PHYS>"


def groups(*rows):
    inner = "".join(f"<VG><LABEL>9</LABEL>{''.join(f'<V>{value}</V>' for value in row)}</VG>" for row in rows)
    return f"<SW-VALUES-PHYS>{inner}</SW-VALUES-PHYS>"


def axis(content, category="STD_AXIS"):
    return f"<SW-AXIS-CONT><CATEGORY>{category}</CATEGORY>{content}</SW-AXIS-CONT>"


def reference(name):
    return f"<SW-INSTANCE-REF>{name}</SW-INSTANCE-REF>"


def instance(name, category, values, *axes, more=""):
    contents = f"<SW-VALUE-CONT>{values}</SW-VALUE-CONT><SW-AXIS-CONTS>{''.join(axes)}</SW-AXIS-CONTS>"
    return (
        f"<SW-INSTANCE><SHORT-NAME>{name}</SHORT-NAME><CATEGORY>{category}</CATEGORY>{contents}{more}</SW-INSTANCE>\n"
    )


@pytest.fixture
def cdfx(written):
    def make(*instances, space="", head=HEAD):
        return written(head + FRAME.format(instances="".join(instances), space=space), "a.cdfx")

    return make


def remarks(path):
    return [str(warning) for warning in describe(path).findings]


def refused(path):
    with pytest.raises(InputError) as caught:
        read(path)
    return [str(finding) for finding in caught.value.findings]


class TestReading:
    def test_a_map_has_a_group_for_each_y(self, cdfx):
        path = cdfx(instance("M", "MAP", groups([1, 2, 3], [4, 5, 6]), axis(numbers(0, 1, 2)), axis(numbers(7, 8))))
        assert read(path)["M"] == Map("M", [0, 1, 2], [7, 8], [[1, 4], [2, 5], [3, 6]])

    def test_a_cuboid_has_groups_within_groups(self, cdfx):
        plane = "<VG><VG><V>1</V><V>2</V></VG><VG><V>3</V><V>4</V></VG><VG><V>5</V><V>6</V></VG></VG>"
        values = f"<SW-VALUES-PHYS>{plane}</SW-VALUES-PHYS>"
        axes = [axis(numbers(0, 1)), axis(numbers(0, 1, 2)), axis(numbers(9))]
        cube = read(cdfx(instance("Q", "CUBOID", values, *axes)))["Q"]
        assert cube == Cube("Q", [[0, 1], [0, 1, 2], [9]], [[[1], [3], [5]], [[2], [4], [6]]])

    @pytest.mark.parametrize("category", ["VALUE", "BOOLEAN", "DEPENDENT_VALUE", "DEPEDNDENT_VALUE"])
    def test_a_number_of_any_category_is_a_scalar(self, cdfx, category):
        assert read(cdfx(instance("K", category, numbers("1.5e1")))) == ParameterSet([Scalar("K", 15)])

    @pytest.mark.parametrize(
        ("category", "kind"),
        [("VALUE", "enumeration"), ("BOOLEAN", "boolean"), ("ASCII", "text"), ("DEPENDENT_VALUE", "enumeration")],
    )
    def test_a_word_is_a_text_of_the_kind_of_its_category(self, cdfx, category, kind):
        path = cdfx(instance("K", category, "<SW-VALUES-PHYS><VT> on </VT></SW-VALUES-PHYS>"))
        assert read(path).texts == (Text("K", " on ", kind=kind),)

    def test_booleans_written_as_numbers_are_scalars_with_a_remark(self, cdfx):
        path = cdfx(instance("K", "BOOLEAN", numbers("1")), instance("L", "BOOLEAN", numbers("0")))
        assert list(read(path)) == ["K", "L"]
        remark = "BOOLEAN with a number, read as a number and written as VALUE or VAL_BLK: 2 labels (K, L)"
        assert remark in "\n".join(map(str, describe(path).findings))

    def test_hexadecimal_and_float_numbers(self, cdfx):
        values = "<SW-VALUES-PHYS><VH>0x1F</VH><VF>.5</VF></SW-VALUES-PHYS>"
        assert read(cdfx(instance("B", "VAL_BLK", values)))["B"] == Block("B", [31, 0.5])

    def test_a_flat_block_takes_the_shape_it_states(self, cdfx):
        size = "<SW-ARRAYSIZE><V>3</V><V>2</V><V>1</V></SW-ARRAYSIZE>"
        assert read(cdfx(instance("B", "VAL_BLK", size + numbers(*range(6)))))["B"] == Block(
            "B", [[0, 3], [1, 4], [2, 5]]
        )

    def test_tables_share_a_common_axis_wherever_it_stands(self, cdfx):
        curve = instance("C", "CURVE", numbers(1, 2), axis(reference("N"), "COM_AXIS"))
        bare = instance("D", "CURVE", numbers(3, 4), f"<SW-AXIS-CONT>{reference('N')}</SW-AXIS-CONT>")
        common = instance("N", "COM_AXIS", "<UNIT-DISPLAY-NAME>rpm</UNIT-DISPLAY-NAME>" + numbers(5, 6))
        shared = Axis([5, 6], unit="rpm", name="N")
        expected = ParameterSet([Curve("C", shared, [1, 2]), Curve("D", shared, [3, 4])], (), [shared])
        assert read(cdfx(curve, bare, common)) == expected

    def test_a_table_whose_common_axis_is_elsewhere_is_skipped(self, cdfx):
        path = cdfx(instance("C", "CURVE", numbers(1, 2), axis(reference("N"), "COM_AXIS")))
        assert len(read(path)) == 0
        assert "(C): refers to the x axis N, which is not in this file; skipped" in remarks(path)[0]

    def test_a_curve_axis_gives_breakpoints_where_the_lookup_stays_the_same(self, cdfx):
        maker = instance("A", "CURVE_AXIS", numbers(0, 1, 2), axis(numbers(10, 40, 90)))
        curve = instance("C", "CURVE", numbers(7, 8, 9), axis(reference("A"), "CURVE_AXIS"))
        assert read(cdfx(curve, maker))["C"] == Curve("C", [10, 40, 90], [7, 8, 9])

    @pytest.mark.parametrize("positions", [(0, 1.5, 2), (0, 0, 2), (1, 2, 3)])
    def test_a_table_whose_curve_axis_bends_elsewhere_is_skipped(self, cdfx, positions):
        maker = instance("A", "CURVE_AXIS", numbers(*positions), axis(numbers(10, 40, 90)))
        path = cdfx(maker, instance("C", "CURVE", numbers(7, 8, 9), axis(reference("A"), "CURVE_AXIS")))
        assert list(read(path)) == ["A"]
        assert "(C): has breakpoints that cannot be derived from the CURVE_AXIS A; skipped" in remarks(path)[0]

    def test_further_variants_of_an_axis_are_skipped(self, cdfx):
        def variants(name, category, first, second, *axes):
            variants = (
                f"<SW-INSTANCE-PROPS-VARIANT>{variant}<SW-VALUE-CONT>{values}</SW-VALUE-CONT>"
                f"<SW-AXIS-CONTS>{''.join(axes)}</SW-AXIS-CONTS></SW-INSTANCE-PROPS-VARIANT>"
                for variant, values in (("", first), ("<VARIANT-DEF-REF>Manual</VARIANT-DEF-REF>", second))
            )
            head = f"<SW-INSTANCE><SHORT-NAME>{name}</SHORT-NAME><CATEGORY>{category}</CATEGORY>"
            return f"{head}<SW-INSTANCE-PROPS-VARIANTS>{''.join(variants)}</SW-INSTANCE-PROPS-VARIANTS></SW-INSTANCE>\n"

        group = variants("N", "COM_AXIS", numbers(1, 2), numbers(3, 4))
        maker = variants("A", "CURVE_AXIS", numbers(0, 1), numbers(0, 2), axis(numbers(10, 40)))
        curves = (
            instance("C", "CURVE", numbers(7, 8), axis(reference("N"), "COM_AXIS")),
            instance("D", "CURVE", numbers(7, 8), axis(reference("A"), "CURVE_AXIS")),
        )
        path = cdfx(group, maker, *curves)
        calibration = read(path)
        assert [list(calibration[name].axes[0].breakpoints) for name in "CD"] == [[1, 2], [10, 40]]
        assert calibration.in_variant("Manual")["A"].values.tolist() == [0, 2]
        [remark] = remarks(path)
        assert "(N): is the axis in another variant (Manual)" in remark

    def test_a_rescale_axis_gives_breakpoints(self, cdfx):
        pairs = instance("A", "RES_AXIS", groups([10, 0], [40, 1]))
        path = cdfx(pairs, instance("C", "CURVE", numbers(7, 8), axis(reference("A"), "RES_AXIS")))
        assert list(read(path).parameters) == [Curve("C", [10, 40], [7, 8])]
        assert "(A)" in remarks(path)[0]

    def test_stated_breakpoints_count_for_a_rescale_axis(self, cdfx):
        shared = axis(reference("A") + numbers(10, 40), "RES_AXIS")
        assert read(cdfx(instance("C", "CURVE", numbers(7, 8), shared)))["C"] == Curve("C", [10, 40], [7, 8])

    def test_all_variants_are_read_and_the_first_counts(self, cdfx):
        criteria = "<SW-VCD-CRITERION-VALUES>{}</SW-VCD-CRITERION-VALUES>".format(
            "".join(
                f"<SW-VCD-CRITERION-VALUE><SW-VCD-CRITERION-REF>{name}</SW-VCD-CRITERION-REF><VT>{value}</VT>"
                "</SW-VCD-CRITERION-VALUE>"
                for name, value in (("Engine", 2), ("Gear", "manual"))
            )
        )
        variants = [("", numbers(1)), ("<VARIANT-DEF-REF>Manual</VARIANT-DEF-REF>", numbers(2)), (criteria, numbers(3))]
        instances = (
            f"<SW-INSTANCE-PROPS-VARIANT>{variant}<SW-VALUE-CONT>{values}</SW-VALUE-CONT></SW-INSTANCE-PROPS-VARIANT>"
            for variant, values in variants
        )
        path = cdfx(
            "<SW-INSTANCE><SHORT-NAME>K</SHORT-NAME><CATEGORY>VALUE</CATEGORY>"
            f"<SW-INSTANCE-PROPS-VARIANTS>{''.join(instances)}</SW-INSTANCE-PROPS-VARIANTS></SW-INSTANCE>"
        )
        others = [Scalar("K", 2, variant="Manual"), Scalar("K", 3, variant="Engine=2,Gear=manual")]
        assert read(path) == ParameterSet([Scalar("K", 1)], others=others)
        assert remarks(path) == []

    def test_labels_within_labels_have_dots(self, cdfx):
        inner = instance("c", "VALUE", numbers(1)) + instance("[0]", "VALUE", numbers(2))
        outer = f"<SW-INSTANCE><SHORT-NAME>a</SHORT-NAME><CATEGORY>STRUCTURE</CATEGORY>{inner}</SW-INSTANCE>"
        assert read(cdfx(outer)) == ParameterSet([Scalar("a.c", 1), Scalar("a[0]", 2)])

    def test_a_namespace_changes_nothing(self, cdfx):
        assert "K" in read(cdfx(instance("K", "VALUE", numbers(1)), space=' xmlns="http://www.asam.net/cdf"'))

    def test_marks_within_a_unit_are_read_in_their_order(self, cdfx):
        unit = "<UNIT-DISPLAY-NAME>kg/m<SUP>3</SUP> dry</UNIT-DISPLAY-NAME>"
        assert read(cdfx(instance("K", "VALUE", unit + numbers(1))))["K"].unit == "kg/m3 dry"

    @pytest.mark.parametrize("encoding", ["utf-8", "iso-8859-1", "utf-16", "utf-8-sig", "windows-1252"])
    def test_the_declared_encoding_counts(self, written, encoding):
        text = FRAME.format(
            space="",
            instances=instance("K", "VALUE", "<UNIT-DISPLAY-NAME>°C</UNIT-DISPLAY-NAME>" + numbers(1)),
        )
        declared = encoding.removesuffix("-sig")
        path = written(f'<?xml version="1.0" encoding="{declared}"?>\n{text}', "a.cdfx", encoding)
        assert read(path)["K"].unit == "°C"

    def test_functions_and_display_names_are_read(self, cdfx):
        more = (
            "<SW-FEATURE-REF>Idle</SW-FEATURE-REF><SW-FEATURE-REF>Trq</SW-FEATURE-REF><DISPLAY-NAME>k1</DISPLAY-NAME>"
        )
        path = cdfx(instance("K", "VALUE", numbers(1), more=more))
        assert read(path)["K"] == Scalar("K", 1, functions=["Idle", "Trq"], display_name="k1")
        assert remarks(path) == []

    @pytest.mark.parametrize("gap", ["", "\n", " ", "\n\t "])
    def test_numbers_may_stand_apart(self, cdfx, gap):
        values = numbers(*range(300)).replace("</V><V>", f"</V>{gap}<V>")
        assert read(cdfx(instance("B", "VAL_BLK", values)))["B"].values.tolist() == list(range(300))

    @pytest.mark.parametrize("more", ["|~^`\\$@", "<![CDATA[</V><V>]]>"])
    def test_any_description_may_stand_beside_numbers(self, cdfx, more):
        path = cdfx(instance("B", "VAL_BLK", numbers(1, 2), more=f"<LONG-NAME>{more}</LONG-NAME>"))
        assert read(path)["B"].values.tolist() == [1, 2]
        assert read(path)["B"].description in (more, "</V><V>")

    @pytest.mark.parametrize(
        ("values", "message"),
        [
            ("<V>1</V>\n<V>2 3</V>", "line 4 (B): must be a finite number, got '2 3'"),
            ("<V>1</V>\n<V></V>\n<V>x</V>", "line 4 (B): must be a finite number, got ''"),
            ("<V>1</V>\n<V>1|2</V>", "line 4 (B): must be a finite number, got '1|2'"),
            ("<V>1</V>\n<V>1_0</V><V>2</V>", "line 4 (B): must be a finite number, got '1_0'"),
        ],
    )
    def test_a_wrong_number_among_many_is_named_with_its_line(self, cdfx, values, message):
        assert message in refused(cdfx(instance("B", "VAL_BLK", f"<SW-VALUES-PHYS>{values}</SW-VALUES-PHYS>")))[0]

    def test_a_table_of_words_is_skipped(self, cdfx):
        values = "<SW-VALUES-PHYS><VT>on</VT><VT>off</VT></SW-VALUES-PHYS>"
        path = cdfx(instance("C", "CURVE", values, axis(numbers(1, 2))))
        assert len(read(path)) == 0
        assert "CURVE contains text" in remarks(path)[0]


class TestRefusing:
    def test_every_problem_is_named_with_its_line(self, cdfx):
        path = cdfx(
            instance("K", "VALUE", numbers(1, 2)),
            instance("C", "CURVE", numbers("1,5", 2), axis(numbers(1, 2))),
            instance("D", "CURVE", numbers(1, 2, 3), axis(numbers(1, 2))),
            instance("E", "CURVE", numbers(1, 2), axis(numbers())),
            instance("F", "MAP", groups([1, 2], [3]), axis(numbers(1, 2)), axis(numbers(1, 2))),
            instance("G", "MAP", groups([1, 2]), axis(numbers(1, 2))),
            instance("H", "CURVE", "", axis(numbers(1, 2))),
            instance("I", "VALUE", numbers("1_000")),
            instance("N", "COM_AXIS", numbers()),
            instance("J", "CURVE", numbers(1, 2), axis(reference("N"))),
            instance("B", "VAL_BLK", "<SW-ARRAYSIZE><V>4</V></SW-ARRAYSIZE>" + numbers(1, 2)),
        )
        assert refused(path) == [
            "a.cdfx line 3 (K): VALUE has 2 values, not one",
            "a.cdfx line 4 (C): must be a finite number, got '1,5'. Write a decimal point.",
            "a.cdfx line 5 (D): CURVE has 3 values, but its axes require 2",
            "a.cdfx line 6 (E): the x axis has no breakpoints",
            "a.cdfx line 7 (F): group 2 has 1 value, but the first has 2 values",
            "a.cdfx line 8 (G): MAP has 1 SW-AXIS-CONT, but needs 2",
            "a.cdfx line 9 (H): CURVE has no SW-VALUES-PHYS",
            "a.cdfx line 10 (I): must be a finite number, got '1_000'",
            "a.cdfx line 11 (N): COM_AXIS has no breakpoints",
            "a.cdfx line 13 (B): VAL_BLK has 2 values, but SW-ARRAYSIZE states 4",
        ]

    def test_a_label_may_come_twice_only_with_the_same_content(self, cdfx):
        once = instance("K", "VALUE", numbers(1))
        assert len(read(cdfx(once, once))) == 1
        assert refused(cdfx(once, instance("K", "VALUE", numbers(2)))) == [
            "a.cdfx line 4 (K): K is already defined in line 3, with different content. Keep one of the two."
        ]

    @pytest.mark.parametrize(
        "entity",
        [
            '<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;">',
            '<!ENTITY a SYSTEM "file:///etc/passwd">',
            '<!ENTITY % a SYSTEM "file:///etc/passwd"> %a;',
        ],
    )
    def test_entities_are_refused_where_they_are_declared(self, cdfx, entity):
        head = f"{HEAD}<!DOCTYPE MSRSW [{entity}]>\n"
        assert refused(cdfx(instance("&a;", "VALUE", numbers(1)), head=head)) == [
            "a.cdfx line 2: declares the entity a. Remove the declarations within <!DOCTYPE ...>."
        ]

    def test_an_entity_of_an_outer_document_is_refused(self, cdfx):
        head = f'{HEAD}<!DOCTYPE MSRSW PUBLIC "a" "http://localhost/cdf.dtd">\n'
        messages = refused(cdfx(instance("K", "VALUE", numbers("&a;")), head=head))
        assert messages == ["a.cdfx line 4: uses the undeclared entity a. Write the characters themselves."]

    def test_endless_depth_is_refused(self, written):
        messages = refused(written(f"{HEAD}<MSRSW>{'<SW-INSTANCE>' * 100_000}", "a.cdfx"))
        assert messages == ["a.cdfx line 2: has elements nested more than 100 levels deep"]

    def test_a_cut_off_file_is_refused(self, cdfx):
        path = cdfx(instance("K", "VALUE", numbers(1)))
        path.write_bytes(path.read_bytes()[:-30])
        assert "is not well-formed XML" in refused(path)[0]

    def test_a_file_without_labels_is_refused(self, written):
        assert "has no SW-INSTANCE-TREE" in refused(written(f"{HEAD}<MSRSW></MSRSW>", "a.cdfx"))[0]


class TestWriting:
    def test_unsupported_contents_are_named(self, tmp_path):
        speed = Axis([1, 2], name="K")
        parameters = ParameterSet([Scalar("K", np.nan), Curve(" C", speed, [1, 2])], [Text("T", "\x01")])
        with pytest.raises(InputError) as caught:
            write(parameters, tmp_path / "a.cdfx")
        assert [str(finding) for finding in caught.value.findings] == [
            "a.cdfx K: is defined twice; parameters, texts and group axes share one namespace. Rename one.",
            "a.cdfx  C: ' C' is not a valid CDFX name: it has surrounding blanks or control characters. Rename it.",
            "a.cdfx K: CDFX cannot store non-finite values. Write it as .json.",
            "a.cdfx T: XML cannot store a text with control characters. Write it as .json.",
        ]
        assert not list(tmp_path.iterdir())

    def test_variants_functions_and_display_names_are_written(self, tmp_path):
        speed = Axis([1, 2], unit="rpm", name="N")
        curve = Curve("C", speed, [1, 2], functions=["Idle", "Trq"], display_name="c", variant="Engine=1,Gear=a=b")
        others = [
            curve.changed(values=np.array([3.0, 4.0]), variant="Engine=2"),
            Scalar("K", 2, variant="Manual"),
            Text("T", "off", variant="Engine=2"),
        ]
        parameters = ParameterSet([curve, Scalar("K", 1), Scalar("L", 1)], [Text("T", "on")], [speed], others)
        write(parameters, tmp_path / "a.cdfx")
        restored = read(tmp_path / "a.cdfx")
        assert restored.in_variant("Engine=2")["C"].values.tolist() == [3, 4]
        assert (restored.parameters, restored.texts, set(restored.others)) == (
            parameters.parameters,
            parameters.texts,
            set(parameters.others),
        )
        assert "<CATEGORY>VCD</CATEGORY>" in (tmp_path / "a.cdfx").read_text(encoding="utf-8")

    def test_a_label_has_one_category_in_all_variants(self, tmp_path):
        parameters = ParameterSet([Scalar("K", 1)], others=[Curve("K", [1, 2], [1, 2], variant="b")])
        with pytest.raises(InputError, match="a CDFX label has one category"):
            write(parameters, tmp_path / "a.cdfx")

    def test_texts_keep_their_line_breaks(self, tmp_path):
        parameters = ParameterSet((), [Text("T", "a\r\nb\t<&>\rc ")])
        write(parameters, tmp_path / "a.cdfx")
        assert read(tmp_path / "a.cdfx") == parameters


def test_the_demo_of_asam_reports_skipped_labels(shared_data):
    path = shared_data / "cdfx/asamint_CDF20demo.cdfx"
    parameters = read(path)
    assert parameters["CDF20.MATRIX_DIM.N341_wS8"].values[:, 1].tolist() == [
        0.4028443250831629,
        0.5005035554063539,
        0.5981627857295450,
    ]
    assert parameters["CDF20.curve.GKL_xCOM_wU16"].axes[0] == Axis(
        [2, 5, 6, 14, 16], unit="°C", name="CDF20.axis.X_AXIS_xU16"
    )
    assert parameters.texts[0] == Text(
        "CDF20.BOOLEAN.FW_wU8", "true", "BIT_MASK 0x0001", ("CDF20_Scalar",), kind="boolean"
    )
    assert len(remarks(path)) == 6


@pytest.mark.parametrize("count", [20, pytest.param(400, marks=pytest.mark.slow)])
def test_mutated_copies_are_read_or_refused(shared_data, tmp_path, count):
    raw = (shared_data / "cdfx/asamint_CDF20demo.cdfx").read_bytes()
    path, chance = tmp_path / "a.cdfx", random.Random(0)
    refusals = 0
    for _ in range(count):
        path.write_bytes(mutated(raw, chance))
        refusals += is_refused(path)
    assert count / 10 < refusals < count


def is_refused(path):
    """Return whether a file is refused; any exception but `InputError` fails the test."""
    try:
        read(path)
    except InputError as error:
        return bool(error.findings)
    return False


def mutated(raw, chance):
    """The file with a few bytes, numbers, tags or pieces changed."""
    changed = bytearray(raw)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(changed))
        piece = chance.choice([b"9", b"<V>1</V>", b"", b"MAP", b"&lt;", b"VG", b"-", b"\xe4", b"COM_AXIS", b" "])
        length = chance.choice([0, 1, 1, len(piece), 400])
        if chance.random() < 0.6:  # within the values, where the document stays well-formed
            at = raw.find(b"<V>", at % len(raw)) + 3
            piece, length = chance.choice([b"9", b"-", b"e", b"1</V><V>", b"</V>", b"1e999", b"nan"]), 1
        changed[at : at + length] = piece
    return bytes(changed)
