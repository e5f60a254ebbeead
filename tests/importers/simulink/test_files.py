import random
import re
import zipfile
from collections import Counter
from pathlib import Path

import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.reader.document import document, read_document
from kennfeld.importers.simulink.reader.model_tree import Endpoint, Ports, split_path
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import ENDINGS, LAYOUTS, Chart, Mask, Model, zipped

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "simulink"


def engine():
    """A model with one of everything."""
    model = Model(
        "engine",
        solver="ode3",
        step="T/10",
        stop="20",
        release="R2019b",
        callbacks={"InitFcn": 'k1 = 2; % "half"\ninit_engine', "PreLoadFcn": "load x.mat"},
        code="K = 3;\nT = 0.1;",
        dictionary="engine.sldd",
        defaults={"Gain": {"Gain": "1", "Multiplication": "Element-wise(K.*u)"}, "Sum": {"Inputs": "++"}},
    )
    model.inport("n engine\n(rpm)")
    model.inport("load")
    model.block("Gain", 'K/2 \\ "x"', Gain="[1 2\n3 4]", signals={1: "half"})
    torque = model.subsystem("Torque", mask=Mask({"a": "k1*2", "how": "fast"}, "tq", "b = a + 1;", texts=("how",)))
    torque.inport("u")
    torque.block("EnablePort", "Enable")
    torque.block("Lookup_n-D", "Map", ports=(2, 1), Table="reshape(M, 2, 3)", OutDataTypeStr="Enum: Gear")
    torque.outport("y")
    torque.line("u", "Map:1", "Map:2")
    torque.chain("Map", "y")
    model.link("Ramp", "mylib/Sub/Ramp\nup", "Ramp", slope="2", start="k1")
    model.block("ModelReference", "Plant", ports=(1, 1), ModelNameDialog="plant.slx")
    model.function("Limit", 'function y = f(u)\n  y = min(u, 3) * "a"; % a < b & c\n', ("u",), ("y",))
    states = {"Off": "Off\nentry: y = 0;", "On": "On\nentry: y = 1;"}
    moves = [("", "Off", ""), ("Off", "On", "[u > 3]"), ("On", "Off", "[u < 2]{k=1;}")]
    model.chart("Shift", Chart(states, moves, [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA")]))
    model.outport("y")
    model.line("n engine\n(rpm)", 'K/2 \\ "x"', "Torque", "Ramp", "Torque#enable", name="speed")
    model.line('K/2 \\ "x"', "Plant")
    model.chain("Plant", "Limit", "Shift", "y")
    return model


@pytest.fixture(scope="module", params=LAYOUTS)
def read(request):
    return document(engine().written(request.param), Path("engine" + ENDINGS[request.param]))


def test_blocks_come_in_order_with_their_parameters_as_written(read):
    assert [block.name for block in read.root.blocks] == [
        "n engine (rpm)", "load", 'K/2 \\ "x"', "Torque", "Ramp", "Plant", "Limit", "Shift", "y",
    ]  # fmt: skip
    gain = read.root.blocks[2]
    assert gain.parameters["Gain"] == "[1 2\n3 4]"
    assert (gain.type, gain.path, split_path(gain.path)) == ("Gain", 'K//2 \\ "x"', ('K/2 \\ "x"',))
    assert gain.signals == {1: "half"}
    assert read.root.by_name["load"].parameters["Port"] == "2"


def test_a_value_is_explicit_or_of_the_file(read):
    gain, lookup = read.root.blocks[2], read.root.at("Torque/Map")
    assert gain.value("Multiplication") == "Element-wise(K.*u)"
    assert gain.value("Gain") == "[1 2\n3 4]"
    assert lookup.value("Table") == "reshape(M, 2, 3)"
    assert lookup.value("ExtrapMethod") is None


def test_lines_lead_from_block_to_blocks(read):
    names = {block.sid: block.name for block in read.root.blocks}
    speed = read.root.lines[0]
    assert speed.name == "speed"
    assert (names[speed.source.block], speed.source.port, speed.source.number) == ("n engine (rpm)", "out", 1)
    ends = [(names[end.block], end.port, end.number) for end in speed.destinations]
    assert ends == [('K/2 \\ "x"', "in", 1), ("Torque", "in", 1), ("Ramp", "in", 1), ("Torque", "enable", 1)]
    assert read.root.lines[1].name == "half"
    assert [end.number for end in read.root.at("Torque").system.lines[0].destinations] == [1, 2]


def test_ports_are_counted_where_the_file_counts_them(read):
    assert read.root.at("Torque").ports == Ports(inputs=1, outputs=1)
    assert read.root.at("Torque/Map").ports == Ports(2, 1)
    assert read.root.at("load").ports is None


def test_masks_links_and_references_are_kept(read):
    mask = read.root.at("Torque").mask
    assert (mask.type, mask.initialization) == ("tq", "b = a + 1;")
    assert [(p.name, p.expression, p.evaluated, p.type) for p in mask.parameters] == [
        ("a", "k1*2", True, "edit"),
        ("how", "fast", False, "edit"),
    ]
    ramp = read.root.at("Ramp")
    assert (ramp.reference.source, ramp.reference.type) == ("mylib/Sub/Ramp up", "Ramp")
    assert dict(ramp.reference.parameters) == {"slope": "2", "start": "k1"}
    assert ramp.value("slope") == "2"
    assert read.root.at("Plant").model == "plant.slx"


def test_functions_and_charts_are_read_with_their_blocks(read):
    limit, shift = read.root.at("Limit"), read.root.at("Shift")
    assert limit.script == 'function y = f(u)\n  y = min(u, 3) * "a"; % a < b & c\n'
    assert (limit.chart.kind, limit.chart.language, shift.chart.kind) == ("MATLAB Function", "MATLAB", "Chart")
    states = {state.id: state.name for state in shift.chart.states}
    moves = [(states.get(t.source, ""), states[t.target], t.label, t.order) for t in shift.chart.transitions]
    assert moves == [("", "Off", "", 1), ("Off", "On", "[u > 3]", 1), ("On", "Off", "[u < 2]{k=1;}", 1)]
    assert [(data.name, data.scope) for data in shift.chart.data] == [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA")]
    assert sum(block.chart is not None for block in read.root.every()) == 2


def test_settings_of_the_whole_model_are_kept(read):
    solver = read.solver
    assert (solver.name, solver.fixed_step, solver.start, solver.stop) == ("ode3", "T/10", "0.0", "20")
    assert dict(read.callbacks) == {"InitFcn": 'k1 = 2; % "half"\ninit_engine', "PreLoadFcn": "load x.mat"}
    assert (read.workspace.kind, read.workspace.text) == ("m-code", "K = 3;\nT = 0.1;")
    assert read.dictionaries == ("engine.sldd",)
    assert (read.name, read.kind, read.warnings) == ("engine", "model", ())


def test_all_but_classic_files_name_the_release():
    versions = [document(engine().written(layout), Path("e")).version for layout in LAYOUTS]
    assert versions == ["R2019b", "R2019b", "R2019b", "8.5", "R2019b"]


def test_all_layouts_give_the_same_tree():
    def facts(layout):
        read = document(engine().written(layout), Path("engine.slx"))
        every = list(read.root.every())
        blocks = [(b.type, b.path, b.sid, b.script, b.mask, b.model, b.signals, b.defaults) for b in every]
        systems = [read.root, *(b.system for b in read.root.every() if b.system)]
        return blocks, [system.lines for system in systems], read.solver, read.callbacks

    inline, *others = map(facts, LAYOUTS)
    assert all(other == inline for other in others)


def test_files_from_before_sids_name_blocks_in_lines():
    model = Model(sids=False)
    model.block("Constant", "c")
    model.block("Gain", "a\nb")
    model.chain("c", "a\nb")
    root = document(model.written("mdl"), Path("m.mdl")).root
    line = root.lines[0]
    assert root.by_sid[line.source.block].name == "c"
    assert root.by_sid[line.destinations[0].block].name == "a b"


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_library_is_not_a_model(layout):
    library = Model("lib", kind="Library")
    library.block("Gain", "K")
    assert document(library.written(layout), Path("lib.slx")).kind == "library"


def test_the_old_mask_strings_are_read():
    text = r"""Model {
  Version 6.0
  Solver "ode4"
  FixedStep "0.02"
  System {
    Block {
      BlockType SubSystem
      Name "S"
      Ports [1, 1]
      MaskType "Old"
      MaskPromptString "Gain|Mode"
      MaskStyleString "edit,popup(slow|fast, now)"
      MaskVariables "k=@1;mode=&2;"
      MaskInitialization "x = k;"
      MaskValueString "a\\|b|fast"
      System {
      }
    }
  }
}
"""
    read = document(text.encode(), Path("old.mdl"))
    mask = read.root.blocks[0].mask
    assert (mask.type, mask.initialization) == ("Old", "x = k;")
    assert [(p.name, p.expression, p.type, p.evaluated) for p in mask.parameters] == [
        ("k", "a|b", "edit", True),
        ("mode", "fast", "popup", False),
    ]
    assert (read.solver.name, read.solver.fixed_step, read.version) == ("ode4", "0.02", "6.0")


def test_a_classic_file_is_read_in_the_encoding_it_names():
    text = 'Model {\nSavedCharacterEncoding "windows-1252"\n'
    text += 'System {\nBlock {\nBlockType Gain\nName "K\xfchlung"\n}\n}\n}\n'
    for encoding in ("cp1252", "utf-8"):
        written = text.replace("windows-1252", encoding.replace("cp", "windows-")).encode(encoding)
        assert document(written, Path("m.mdl")).root.blocks[0].name == "K\xfchlung"


def test_a_mask_over_a_link_is_kept_with_the_instance():
    mask = '<Mask><MaskParameter Name="k" Type="edit"><Value>3</Value></MaskParameter></Mask>'
    link = f'<P Name="SourceBlock">lib/S</P><InstanceData><P Name="a">1</P>{mask}</InstanceData>'
    read = document(
        diagram(f'<System><Block BlockType="Reference" Name="L" SID="1">{link}</Block></System>'), Path("m")
    )
    [block] = read.root.blocks
    assert [(p.name, p.expression) for p in block.mask.parameters] == [("k", "3")]
    assert dict(block.reference.parameters) == {"a": "1"}


def test_values_kept_in_another_part_are_named():
    data = '<P Name="UserData" Ref="bdmxdata:UserData_1"/><P Name="Gain">2</P>'
    read = document(diagram(f'<System><Block BlockType="Gain" Name="K" SID="1">{data}</Block></System>'), Path("m"))
    [block] = read.root.blocks
    assert dict(block.parameters) == {"Gain": "2"}


def test_special_ports_and_physical_connections_are_distinguished_from_others():
    blocks = "".join(f'<Block BlockType="X" Name="b{n}" SID="{n}"/>' for n in (1, 2))
    lines = ("1#stateport", "1#out:3", "2#lconn:2", "2#Reset", "2#ifaction")
    text = "".join(f'<Line><P Name="Src">{end}</P></Line>' for end in lines)
    read = document(diagram(f"<System>{blocks}{text}</System>"), Path("m.slx"))
    assert [(line.source.port, line.source.number) for line in read.root.lines] == [
        ("state", 1), ("out", 3), ("lconn", 2), ("reset", 1), ("ifaction", 1),
    ]  # fmt: skip


def test_a_matrix_that_never_closes_ends_with_its_line():
    read = document(b"Model {\nSystem {\nBlock {\nBlockType Gain\nName g\nGain [1\nOther [2\n}\n}\n}\n", Path("m.mdl"))
    assert read.root.blocks[0].parameters["Gain"].startswith("[1")
    assert read.root.blocks[0].name == "g"


def test_a_matrix_may_go_on_over_lines_and_comments_are_left_out():
    text = "# made by hand\nModel {\n System {\n Block {\n BlockType Constant\n Name c\n Value [1 2;\n 3 4]\n"
    read = document((text + " # no value\n SampleTime -1\n}\n}\n}\n").encode(), Path("m.mdl"))
    assert dict(read.root.blocks[0].parameters) == {"Value": "[1 2; 3 4]", "SampleTime": "-1"}


def test_a_configuration_kept_elsewhere_is_named():
    parts = {
        "simulink/blockdiagram.xml": "<ModelInformation><Model><System/></Model></ModelInformation>",
        "simulink/configSetInfo.xml": (
            '<C><ConfigSet PartName="/simulink/configSet0.xml">A</ConfigSet>'
            '<ConfigSet PartName="/simulink/configSet1.xml" Active="true">B</ConfigSet></C>'
        ),
        "simulink/configSet0.xml": '<C><Object ClassName="Simulink.SolverCC"><P Name="Solver">ode1</P></Object></C>',
        "simulink/configSet1.xml": (
            '<C><Object ClassName="Simulink.ConfigSetRef"><P Name="SourceName">Shared</P></Object></C>'
        ),
    }
    solver = document(zipped(parts), Path("m.slx")).solver
    assert (solver.name, solver.reference) == ("", "Shared")


def test_old_names_of_the_solver_are_read():
    parts = {
        "simulink/blockdiagram.xml": "<ModelInformation><Model><System/></Model></ModelInformation>",
        "simulink/configSet0.xml": '<C><Object ClassName="Simulink.SolverCC"><P Name="Solver">ode1</P></Object></C>',
    }
    assert document(zipped(parts), Path("m.slx")).solver.name == "ode1"


def diagram(inside):
    return zipped({"simulink/blockdiagram.xml": f"<ModelInformation><Model>{inside}</Model></ModelInformation>"})


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"", "is empty"),
        (b"Name = 1\n", "is not a Simulink file"),
        (b"PK\3\4" + b"\0" * 60, "damaged zip archive"),
        (zipped({"a.txt": "b"}), "part simulink/blockdiagram.xml is missing"),
        (zipped({"simulink/blockdiagram_encrypted.bin": "b"}), "protected model"),
        (zipped({"data/chunk0.xml": "<DataSource/>"}), "is a data dictionary"),
        (diagram("<System>"), "not well-formed XML"),
        (diagram("<Library/>")[:150], "damaged zip archive"),
        (diagram('<System><Block BlockType="SubSystem" Name="S" SID="1"><System Ref="system_1"/></Block></System>'),
         "has its content in system_1, which is missing"),
        (diagram("<a>" * 300 + "</a>" * 300), "levels deep"),
        (b"Model {\n System {\n}\n", "is truncated: Model of line 1 is never closed"),
        (b"Model {\n}\n}\n", "unmatched }"),
        (b"Model {\n{\n}\n", "neither a key"),
        (b"Model {\n" * 300, "levels deep"),
        (b"__MWOPC_PACKAGE_BEGIN__ R2022a\n__MWOPC_PART_BEGIN__ /simulink/blockdiagram.xml\n<a/>", "is truncated"),
    ],
)  # fmt: skip
def test_broken_files_are_reported_in_a_sentence(raw, message):
    with pytest.raises(InputError) as raised:
        document(raw, Path("engine.slx"))
    assert all(str(finding).startswith("engine.slx") for finding in raised.value.findings)
    assert message in str(raised.value)


@pytest.mark.parametrize("text", ["{", "[]", '{"a": ' * 100_000, '{"a":' * 500 + "1" + "}" * 500, '{"b": 1, "c": 2}'])
def test_broken_and_foreign_json_is_refused(text):
    with pytest.raises(InputError, match=r"m\.slx simulink/blockDiagram\.json"):
        document(zipped({"simulink/blockDiagram.json": text}), Path("m.slx"))


def test_entities_are_refused_where_they_are_declared():
    bomb = '<!DOCTYPE a [<!ENTITY b "ha"><!ENTITY c "&b;&b;">]><ModelInformation><Model>&c;</Model></ModelInformation>'
    file = '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><ModelInformation>&b;</ModelInformation>'
    for text in (bomb, file):
        with pytest.raises(InputError, match=r"simulink/blockdiagram.xml line 1: declares the entity b"):
            document(zipped({"simulink/blockdiagram.xml": text}), Path("m.slx"))


def test_a_system_that_holds_itself_is_refused():
    inner = '<System><Block BlockType="SubSystem" Name="S" SID="1"><System Ref="system_1"/></Block></System>'
    parts = {
        "simulink/blockdiagram.xml": '<ModelInformation><Model><System Ref="system_1"/></Model></ModelInformation>',
        "simulink/systems/system_1.xml": inner,
    }
    with pytest.raises(InputError, match="has its content in system_1, which is used twice"):
        document(zipped(parts), Path("m.slx"))


def test_systems_that_share_their_content_do_not_multiply_without_end():
    """Each of 40 systems holds the next one ten times: unrolled, more blocks than there is memory for."""
    parts = {"simulink/blockdiagram.xml": '<M><Model><System Ref="system_0"/></Model></M>'}
    for at in range(40):
        blocks = "".join(
            f'<Block BlockType="SubSystem" Name="S{n}" SID="{n}"><System Ref="system_{at + 1}"/></Block>'
            for n in range(10)
        )
        parts[f"simulink/systems/system_{at}.xml"] = f"<System>{blocks}</System>"
    with pytest.raises(InputError, match="which is used twice"):
        document(zipped(parts), Path("m.slx"))


def test_a_zip_that_unpacks_to_too_much_is_refused(monkeypatch):
    monkeypatch.setattr("kennfeld.importers.simulink.reader.model_package._BASE_UNPACKED_BYTES", 1_000_000)
    raw = zipped({"simulink/blockdiagram.xml": "<ModelInformation>" + " " * 7_000_000 + "</ModelInformation>"})
    with pytest.raises(InputError, match="expands to far more data than a model"):
        document(raw, Path("m.slx"))


def test_lines_to_missing_blocks_count_as_loose_and_are_reported():
    block = '<Block BlockType="Gain" Name="K" SID="1"/>'
    line = '<Line><P Name="Src">1#out:1</P><P Name="Dst">9#in:1</P></Line><Line><P Name="Dst">1#in:1</P></Line>'
    read = document(diagram(f"<System>{block}{line}</System>"), Path("m.slx"))
    assert read.root.lines[0].destinations == ()
    assert (read.root.lines[1].source, read.root.lines[1].destinations) == (None, (Endpoint("1", "in", 1),))
    assert [*map(str, read.warnings)] == [
        "the root has a line to the unknown block or port 9#in:1; it is treated as unconnected"
    ]


@pytest.mark.slow
@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx json", "mdl"]))
def test_two_thousand_blocks_are_read(layout):
    model = Model()
    for number in range(20):
        inner = model.subsystem(f"S{number}")
        inner.inport("u")
        for gain in range(98):
            inner.block("Gain", f"K{gain}", Gain=f"k{gain}")
        inner.outport("y")
        inner.chain("u", *(f"K{gain}" for gain in range(98)), "y")
    read = document(model.written(layout), Path("m.slx"))
    assert Counter(block.type for block in read.root.every())["Gain"] == 1960
    assert sum(len(block.system.lines) for block in read.root.blocks) == 1980


def read_or_refused(raw):
    """Return whether bytes are read; any exception but `InputError` fails the test."""
    try:
        document(raw, Path("m.slx"))
    except InputError:
        return False
    return True


GARBLED = [pytest.param(60, id="few"), pytest.param(300, id="many", marks=pytest.mark.slow)]  # copies


@pytest.mark.parametrize("garbled", GARBLED)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_garbled_copies_are_read_or_refused_but_never_crash(layout, garbled):
    whole = engine().written(layout)
    assert read_or_refused(whole)
    chance = random.Random(6)
    for _ in range(garbled):
        raw = bytearray(whole)
        for _ in range(chance.choice((1, 3, 30))):
            raw[chance.randrange(len(raw))] = chance.randrange(256)
        if chance.random() < 0.3:
            del raw[chance.randrange(len(raw)) :]
        read_or_refused(bytes(raw))


@pytest.mark.parametrize("garbled", GARBLED)
@pytest.mark.parametrize("layout", ["slx inline", "slx parts", "slx json"])
def test_garbled_parts_of_whole_archives_are_read_or_refused(layout, garbled, tmp_path):
    """The zip's own checks would stop garbled bytes before any of ours."""
    chance = random.Random(7)
    with zipfile.ZipFile(engine().write(tmp_path, layout)) as archive:
        whole = {name: archive.read(name) for name in archive.namelist()}
    names = [name for name in whole if name.startswith("simulink/")]
    for _ in range(garbled):
        parts = dict(whole)
        name = chance.choice(names)
        raw = bytearray(parts[name])
        start = chance.randrange(len(raw))
        change = chance.choice(("cut", "double", "swap"))
        if change == "cut":
            del raw[start : start + chance.randrange(1, 40)]
        elif change == "double":
            raw[start:start] = raw[start : start + chance.randrange(1, 40)]
        else:
            raw[start] = chance.randrange(256)
        parts[name] = bytes(raw)
        read_or_refused(zipped(parts))


def needs_data(name):
    if not (DATA / name).is_file():
        pytest.skip(f"the model is not at {DATA / name}")
    return DATA / name


REAL = {
    "AbstractFuelControl_M1.slx": "R2017b",
    "Autotrans_Model.mdl": "8.5",
    "Dyn_Vol_Line.slx": "R2015a",
    "GasTurbine_Dyn_Template.mdl": "8.5",
    "VentilatorModel_v8_5.slx": "R2017b",
    "automatic_transmission.slx": "R2017b",
    "controller.slx": "R2020a",
    "fuel_control.slx": "R2018a",
    "idle_speed_control.slx": "R2018a",
    "vehicle_model.slx": "R2023a",
}


def diagrams(path):
    """The text of the systems of a file, without the defaults and Stateflow."""
    if path.suffix == ".mdl":
        text = path.read_text(encoding="cp1252")
        return text[text.index("\n  System {") : text.index("\nStateflow {") if "\nStateflow {" in text else len(text)]
    with zipfile.ZipFile(path) as archive:
        names = [n for n in archive.namelist() if re.match(r"simulink/(blockdiagram|systems/\w+)\.xml$", n)]
        text = "".join(archive.read(name).decode() for name in names)
    return re.sub(r"<BlockParameterDefaults>.*?</BlockParameterDefaults>", "", text, flags=re.DOTALL)


@pytest.mark.parametrize(("name", "version"), REAL.items())
def test_real_files_hold_as_many_blocks_lines_and_ends_as_their_text(name, version):
    path = needs_data(name)
    text = diagrams(path)
    classic = path.suffix == ".mdl"
    read = read_document(path)
    systems = [read.root, *(block.system for block in read.root.every() if block.system is not None)]
    lines = [line for system in systems for line in system.lines]
    types = Counter(
        re.findall(r"^\s*BlockType\s+(\S+)" if classic else r'<Block BlockType="([^"]+)"', text, re.MULTILINE)
    )
    assert Counter(block.type for block in read.root.every()) == types
    assert len(lines) == len(re.findall(r"^\s*Line \{" if classic else r"<Line>", text, re.MULTILINE))
    ends = len(re.findall(r"^\s*DstBlock" if classic else r'<P Name="Dst">', text, re.MULTILINE))
    assert sum(len(line.destinations) for line in lines) == ends
    assert (read.version, read.warnings) == (version, ())


@pytest.mark.parametrize("name", REAL)
def test_no_line_of_a_real_file_ends_at_a_port_that_is_not_counted(name):
    root = read_document(needs_data(name)).root
    systems = [root, *(block.system for block in root.every() if block.system is not None)]
    for system in systems:
        ends = [end for line in system.lines for end in (line.source, *line.destinations) if end is not None]
        for end in ends:
            ports = system.by_sid[end.block].ports
            counts = {"in": ports.inputs, "out": ports.outputs} if ports is not None else {"in": 3, "out": 1}
            assert end.number <= counts.get(end.port, end.number)


def test_real_files_show_their_masks_charts_and_links():
    needs_data("controller.slx")
    controller, line = read_document(DATA / "controller.slx"), read_document(DATA / "Dyn_Vol_Line.slx")
    classic, newer = read_document(DATA / "Autotrans_Model.mdl"), read_document(DATA / "automatic_transmission.slx")
    mask = controller.root.at("Controller").mask
    assert (mask.type, len(mask.parameters)) == ("Controller", 23)
    assert "FixedStep" in mask.initialization
    assert len(controller.root.at("Controller/Pulse Generator").chart.transitions) == 10
    pipe = next(block for block in line.root.every() if block.reference and "Source" in block.reference.source)
    assert pipe.reference.parameters["T_vec_M"] == "[0 0.1 5]"
    charts = [file.root.at("ShiftLogic").chart for file in (classic, newer)]
    assert len({frozenset((s.id, s.label, s.parent) for s in chart.states) for chart in charts}) == 1
    assert len({frozenset((t.id, t.label, t.source, t.target) for t in chart.transitions) for chart in charts}) == 1
    assert read_document(DATA / "vehicle_model.slx").solver.reference == "SharedConfig"


def test_a_port_for_one_element_of_a_bus_names_it(tmp_path):
    drawn = Model("bus")
    drawn.inport("In Bus Element")
    drawn.inport("Plain")
    path = drawn.write(tmp_path, "slx parts")
    listed = {"PortNumber": 1, "PortName": "Engine", "Element": "air.p", "IsComposite": 1}
    entries = "".join(f'<P Name="{name}">{value}</P>' for name, value in listed.items())
    with zipfile.ZipFile(path) as package:
        parts = {name: package.read(name).decode() for name in package.namelist()}
    for name, text in parts.items():
        interface = f'<List ListType="InterfaceData">{entries}</List></Block>'
        parts[name] = re.sub(
            r'(Name="In Bus Element".*?)</Block>', lambda m, g=interface: m[1] + g, text, flags=re.DOTALL
        )
    with zipfile.ZipFile(path, "w") as package:
        for name, text in parts.items():
            package.writestr(name, text)
    element, plain = read_document(path).root.blocks
    assert [element.value(name) for name in ("IsBusElementPort", "PortName", "Element")] == ["on", "Engine", "air.p"]
    assert plain.value("IsBusElementPort") is None
