// The channels: what the function reads, where from, how it looks in every file, and its shift.

import { computed } from "@preact/signals";
import {
  addShift,
  chosen,
  entries,
  errors,
  fileCount,
  inputs,
  mapped,
  recorded,
  scanShift,
  scans,
  search,
  setShift,
  shiftOf,
  shownChannel,
  shownRows,
  small,
} from "../../data-files";
import { extent, line, type Pen } from "../../drawing/canvas";
import { token } from "../../drawing/colours";
import { counted, MISSING, numberText, parseNumber, plain, signed, significant, unitText } from "../../drawing/numbers";
import { pairPositions } from "../../drawing/strips";
import { Segment } from "../../fields";
import { Icon } from "../../icons";
import { LineInput } from "../../inputs";
import { FindingLine } from "../../instruments/finding";
import { Picture } from "../../instruments/picture";
import { Proposals } from "../../instruments/proposals";
import type { ChannelRow, MappedInput } from "../../replies";
import { scoped } from "../../scope";
import { setKeys } from "../../settings";
import { secondsPerPixel, shiftOfDrag, slotOf } from "../../shift-drag";
import { message, screen, settled, state } from "../../store";

const MAX_FURTHER = 300; // channels that nothing reads, of which rows are drawn
const MAX_HEADS = 6; // files that are named above their lines

/** Channels that nothing reads. */
const further = computed(() => {
  const read = new Set(mapped.value);
  return [...recorded.value.keys()].filter((name) => !read.has(name));
});

const isProblem = (own: MappedInput): boolean => {
  const facts = small.value?.signals[mapped.value.indexOf(own.channel)];
  return !recorded.value.has(own.channel) || facts?.missing !== "" || Object.keys(facts.gaps).length > 0;
};

export function ChannelTable() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const fits = (text: string) => words.every((word) => text.toLowerCase().includes(word));
  const reads = inputs.value.filter(
    (each) =>
      shownRows.value !== "not used" &&
      (shownRows.value !== "problems" || isProblem(each)) &&
      fits(`${each.name} ${each.channel} ${each.unit}`),
  );
  const others =
    shownRows.value === "all" || shownRows.value === "not used"
      ? further.value.filter((name) => fits(`${name} ${recorded.value.get(name)?.unit ?? ""}`))
      : [];
  const remarks = state.value.findings.filter((f) => f.screen === "data" && f.severity !== "remark");
  const files = errors.value?.files ?? [];
  return (
    <section class="pane channels">
      <div class="head">
        <h2>Channels</h2>
        <span class="sub">
          {counted(mapped.value.length, "channel")} mapped · {further.value.length} not used
        </span>
        <span class="right">
          <label class="field small">
            <Icon name="find" kind="q" />
            <input
              placeholder="Name, unit"
              aria-label="Search channels"
              value={search.value}
              onInput={(event) => {
                search.value = event.currentTarget.value;
              }}
            />
          </label>
          <Segment
            label="Channels that are listed"
            options={["all", "mapped", "problems", "not used"]}
            chosen={shownRows.value}
            choose={(option) => {
              shownRows.value = option as typeof shownRows.value;
            }}
          />
        </span>
      </div>
      <Remarks own={remarks} />
      <div class="items" onKeyDown={keys}>
        <table class="list">
          <thead>
            <tr>
              <th>the function reads</th>
              <th>channel</th>
              <th>unit</th>
              <th class="num">least</th>
              <th class="num">greatest</th>
              <th class="lines">
                <span class="heads">
                  {files.length === 0 ? (
                    <span>in each file</span>
                  ) : files.length > MAX_HEADS ? (
                    <span>{counted(files.length, "file")}, one after the other</span>
                  ) : (
                    files.map((each) => (
                      <span class="cut" title={each.name}>
                        {each.name}
                      </span>
                    ))
                  )}
                </span>
              </th>
              <th>shift</th>
              <th class="num">estimated</th>
              <th>missing</th>
            </tr>
          </thead>
          <tbody>
            {reads.map((each) => (
              <Row own={each} />
            ))}
            {others.slice(0, MAX_FURTHER).map((name) => (
              <Further name={name} />
            ))}
          </tbody>
        </table>
        {others.length > MAX_FURTHER && (
          <p class="pad q">{others.length - MAX_FURTHER} more channels; search to find them.</p>
        )}
        {inputs.value.length === 0 && (
          <p class="pad q">
            The inputs of the function are listed here once its text is written.{" "}
            <button
              class="btn small"
              onClick={() => {
                screen.value = "function";
              }}
            >
              Function
            </button>
          </p>
        )}
        <Proposals />
      </div>
    </section>
  );
}

function Remarks({ own }: { own: typeof state.value.findings }) {
  if (own.length === 0) return null;
  return (
    <div class="cks">
      {own.map((f) => (
        <FindingLine key={f.text} own={f} />
      ))}
    </div>
  );
}

/** Rows by arrows; `m` opens the list of channels, Shift with an arrow shifts by a sample. */
function keys(event: KeyboardEvent): void {
  const row = (event.target as HTMLElement).closest<HTMLElement>("tr[data-channel]");
  if (row === null || event.target !== row) return;
  const side = { ArrowUp: row.previousElementSibling, ArrowDown: row.nextElementSibling }[event.key];
  const channel = row.dataset.channel!;
  if (side instanceof HTMLElement) {
    side.focus();
    chosen.value = side.dataset.channel ?? "";
  } else if (event.key === "m") row.querySelector("select")?.focus();
  else if (event.shiftKey && (event.key === "ArrowLeft" || event.key === "ArrowRight")) {
    const step = sampleStep();
    if (step === null || shiftOf(channel) === "auto") message.value = "Only recordings with time stamps are shifted.";
    else addShift(channel, event.key === "ArrowLeft" ? -step : step);
  } else return;
  event.preventDefault();
}

/** A drag along the line of a channel: where it began, and the shift that it asks for. */
const drag = scoped<{ channel: string; from: number; seconds: number } | null>(null);

type CellPointer = PointerEvent & { currentTarget: HTMLElement };

const isShiftable = (channel: string): boolean => sampleStep() !== null && shiftOf(channel) !== "auto";

/** What handles a drag to the side, which shifts a channel by whole samples. */
function dragOf(channel: string) {
  const end = (keep: boolean) => {
    const own = drag.value;
    drag.value = null;
    if (keep && own !== null && own.seconds !== 0) addShift(channel, own.seconds);
  };
  return {
    onPointerDown: (event: CellPointer) => {
      if (event.button !== 0 || !isShiftable(channel)) return;
      event.currentTarget.setPointerCapture(event.pointerId);
      drag.value = { channel, from: event.clientX, seconds: 0 };
    },
    onPointerMove: (event: CellPointer) => {
      if (drag.value?.channel !== channel) return;
      const { left, width } = event.currentTarget.getBoundingClientRect();
      const [from, to] = [drag.value.from - left, event.clientX - left];
      const seconds = shiftOfDrag(from, to, width, errors.value?.files ?? [], sampleStep() ?? 0);
      if (seconds === drag.value.seconds) return;
      drag.value = { ...drag.value, seconds };
      message.value = `${channel}: ${signed(seconds)} s`;
    },
    onPointerUp: () => end(true),
    onPointerCancel: () => end(false),
  };
}

/** The shortest time between samples of the used files; null for steady points. */
function sampleStep(): number | null {
  const steps = entries.value
    .filter((each) => each.use !== "off")
    .flatMap((each) => each.files.map((file) => file.step ?? 0))
    .filter((step) => step > 0);
  return steps.length === 0 ? null : Math.min(...steps);
}

function Row({ own }: { own: MappedInput }) {
  const described = recorded.value.get(own.channel);
  const at = mapped.value.indexOf(own.channel);
  const facts = small.value?.signals[at];
  const moved = drag.value?.channel === own.channel ? drag.value.seconds : 0;
  const gaps = Object.values(facts?.gaps ?? {}).reduce((sum, each) => sum + each.length, 0);
  return (
    <tr
      class={own.channel === shownChannel.value ? "on" : ""}
      data-channel={own.channel}
      tabIndex={0}
      onClick={() => {
        chosen.value = own.channel;
      }}
    >
      <td>
        <b>{own.name}</b> {own.role === "target" && <span class="tag t">target</span>}
      </td>
      <td>
        <select
          class="field small"
          style={{ width: "112px" }}
          aria-label={`Channel of ${own.name}`}
          value={own.channel}
          onChange={(event) => map(own, event.currentTarget.value)}
        >
          {described === undefined && <option value={own.channel}>{own.channel}</option>}
          <ChannelOptions />
        </select>
      </td>
      <td class={described === undefined ? "bad" : ""}>
        {described === undefined ? "no such channel" : unitOf(own.unit, described.unit)}
      </td>
      <td class="num">{numberText(described?.least)}</td>
      <td class="num">{numberText(described?.greatest)}</td>
      <td
        class="line"
        title={isShiftable(own.channel) ? "A drag to the side shifts the channel" : ""}
        {...dragOf(own.channel)}
      >
        <Picture
          label={`${own.channel} in all files`}
          kind="spark"
          draw={(pen, wide, high) => drawLines(pen, wide, high, at, moved)}
          of={[small.value, at, fileCount.value, moved]}
        />
      </td>
      <td>
        <ShiftField channel={own.channel} />
      </td>
      <td class="num">
        <Estimate channel={own.channel} />
      </td>
      <td>
        {facts?.missing ? (
          <span class="bad">{facts.missing}</span>
        ) : gaps > 0 ? (
          <span class="tag w">{counted(gaps, "gap")}</span>
        ) : (
          <span class="q">none</span>
        )}
      </td>
    </tr>
  );
}

/** The channels to choose from, below the names of their groups if a file has several. */
function ChannelOptions() {
  const options = (rows: Iterable<ChannelRow>) =>
    [...rows].map((each) => (
      <option value={each.name} title={`${each.name} ${each.unit}`}>
        {each.name}
      </option>
    ));
  const groups = new Map<string, ChannelRow[]>();
  for (const each of recorded.value.values()) groups.set(each.group, [...(groups.get(each.group) ?? []), each]);
  if (groups.size < 2) return <>{options(recorded.value.values())}</>;
  const steps = new Map(entries.value.flatMap((e) => e.files).flatMap((f) => f.groups.map((g) => [g.name, g.step])));
  return (
    <>
      {[...groups].map(([group, own]) => (
        <optgroup
          label={steps.has(group) ? `${group}, every ${significant(steps.get(group)!, 3)} s` : group || "others"}
        >
          {options(own)}
        </optgroup>
      ))}
    </>
  );
}

/** The unit of a channel: that of the function, or how it is converted. */
function unitOf(wanted: string, own: string) {
  if (!unitText(wanted) || wanted === own) return <>{own || MISSING}</>;
  return (
    <span class="warn" title={own ? `Converted from ${own} to ${wanted}` : `Without a unit, taken as ${wanted}`}>
      {own ? `${own} → ${wanted}` : `takes ${wanted}`}
    </span>
  );
}

function Further({ name }: { name: string }) {
  const own = recorded.value.get(name)!;
  return (
    <tr
      class={`off ${name === shownChannel.value ? "on" : ""}`}
      data-channel={name}
      tabIndex={0}
      title={own.group}
      onClick={() => {
        chosen.value = name;
      }}
    >
      <td>not used</td>
      <td class="mono">{name}</td>
      <td>{own.unit || MISSING}</td>
      <td class="num">{numberText(own.least)}</td>
      <td class="num">{numberText(own.greatest)}</td>
      <td class="q">in no node; a click shows it below</td>
      <td />
      <td />
      <td />
    </tr>
  );
}

function ShiftField({ channel }: { channel: string }) {
  const shift = shiftOf(channel);
  const timed = settled.value.datasets.some((each) => each.timed);
  return (
    <span class="field small num shift" title="value(t) = recorded(t − shift), in all datasets; auto estimates it">
      <LineInput
        label={`Shift of ${channel}`}
        placeholder={shift === null ? "several" : "0"}
        text={shift === null || shift === 0 ? "" : String(shift)}
        enter={(text) => {
          const typed = text.trim().toLowerCase();
          const number = typed === "" ? 0 : parseNumber(typed);
          if (typed === "auto") setShift(channel, "auto");
          else if (number !== null) setShift(channel, number);
          else message.value = `A shift is a number or auto, not ${text}`;
        }}
      />
      <u>{timed ? "s" : ""}</u>
    </span>
  );
}

function Estimate({ channel }: { channel: string }) {
  const own = (errors.value?.shifts ?? []).filter((each) => each.channel === channel);
  const scan = scans.value[channel];
  if (shiftOf(channel) === "auto")
    return own.length > 0 ? (
      <b title="As the last run has estimated it">{[...new Set(own.map((each) => plain(each.shift, 4)))].join(", ")}</b>
    ) : (
      <span class="q">by the next run</span>
    );
  if (!settled.value.datasets.some((each) => each.timed)) return <span class="q">{MISSING}</span>;
  if (scan === undefined)
    return (
      <button
        class="btn bare small"
        title="The error over the shift, with the present values"
        aria-label={`Estimate the shift of ${channel}`}
        onClick={() => {
          chosen.value = channel;
          void scanShift(channel);
        }}
      >
        estimate
      </button>
    );
  if (!scan.seen) return <span class="q">not seen</span>;
  return (
    <span>
      <b>{significant(scan.best, 2)}</b> ± {numberText(scan.deviation, 1)}
    </span>
  );
}

/** The lines of a channel in all files, on one scale; a gap is a hole. While they are dragged, the recorded ones stay. */
function drawLines(pen: Pen, wide: number, high: number, signal: number, moved: number): void {
  const files = errors.value?.files.length ?? 0;
  const lines = small.value?.lines ?? {};
  const own = Array.from({ length: files }, (_, k) => lines[`${signal} ${k}`] ?? new Float32Array());
  const [low, top] = extent(...own);
  const each = wide / Math.max(1, files);
  own.forEach((points, k) => {
    if (k > 0) {
      pen.fillStyle = token("line");
      pen.fillRect(Math.round(k * each), 0, 1, high);
    }
    if (points.length < 4) return;
    const [left, right] = slotOf(k, files, wide);
    const xs = pairPositions(points, left, right);
    const ys = Float64Array.from(points, (y) => high - 3 - (top > low ? (y - low) / (top - low) : 0.5) * (high - 6));
    if (moved !== 0) line(pen, xs, ys, token("before"), 1);
    const scale = secondsPerPixel(k, errors.value?.files ?? [], wide);
    const by = moved === 0 || scale === 0 ? 0 : moved / scale;
    const shown = xs.map((x) => (x + by >= left && x + by <= right ? x + by : NaN));
    line(pen, shown, ys, token("measured"), 1);
  });
}

function map(own: MappedInput, channel: string): void {
  const title = `${own.name} is read from ${channel}`;
  if (own.role === "target") void setKeys([[["criterion", own.number!, "target"], { channel }]], title);
  else void setKeys([[["channels", own.name], channel === own.name ? null : channel]], title);
}
