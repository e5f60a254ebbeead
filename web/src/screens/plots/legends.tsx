// Beside each strip: its signals with their values at the cursor, and statistics of what is brushed.

import { useSignal } from "@preact/signals";
import { MISSING, numberText, signed, significant, unitText } from "../../drawing/numbers";
import { valueUnder } from "../../hover-values";
import { brushed, drawn, sample } from "../../plot-data";
import { cursor, hover, keyOf } from "../../plots";
import type { SignalRow } from "../../replies";
import { settled } from "../../store";
import {
  active,
  addLine,
  type Line,
  moveStrip,
  type Row,
  removeLine,
  removeStrip,
  resizeStrip,
  rows,
  SIGNAL,
} from "../../strip-rows";

const STRIP = "application/x-kennfeld-strip";

export function Legends() {
  return (
    <div class="legends" role="group" aria-label="Strips" data-legend>
      {rows.value.map((row, r) => (
        <Legend key={r} row={row} r={r} />
      ))}
    </div>
  );
}

function Legend({ row, r }: { row: Row; r: number }) {
  const over = useSignal(false);
  const drop = (event: DragEvent) => {
    event.preventDefault();
    over.value = false;
    const [strip, own] = [event.dataTransfer?.getData(STRIP), event.dataTransfer?.getData(SIGNAL)];
    if (strip) moveStrip(Number(strip), r);
    else if (own) addLine(r, JSON.parse(own) as SignalRow);
  };
  const key = (event: KeyboardEvent) => {
    const moves: Record<string, () => void> = {
      Delete: () => removeStrip(r),
      "+": () => resizeStrip(r, 0.2),
      "-": () => resizeStrip(r, -0.2),
      Enter: () => {
        active.value = r;
      },
      ...(event.altKey ? { ArrowUp: () => refocus(event, r, -1), ArrowDown: () => refocus(event, r, 1) } : {}),
    };
    const move = moves[event.key];
    if (move === undefined || event.target !== event.currentTarget) return;
    move();
    event.preventDefault();
    event.stopPropagation();
  };
  return (
    <div
      class={`leg ${active.value === r ? "on" : ""} ${over.value ? "over" : ""}`}
      style={{ flex: `${row.weight} 0 0` }}
      data-strip={r}
      tabIndex={0}
      role="group"
      draggable
      aria-label={`Strip ${row.title}`}
      title={`${row.title}\nDrag to move, drop a signal to add it. Keys: Alt ↑ ↓ move, + − height, Del remove`}
      onFocus={() => {
        active.value = r;
      }}
      onPointerDown={() => {
        active.value = r;
      }}
      onKeyDown={key}
      onDragStart={(event) => event.dataTransfer?.setData(STRIP, String(r))}
      onDragLeave={() => {
        over.value = false;
      }}
      onDrop={drop}
      onDragOver={(event) => {
        if (event.dataTransfer?.types.some((type) => type === STRIP || type === SIGNAL)) {
          event.preventDefault();
          over.value = true;
        }
      }}
    >
      <div class="nm">
        <b class="cut">{row.title}</b>
        <span class="q">{unitText(row.unit)}</span>
        <button
          class="x"
          tabIndex={-1}
          aria-label={`Remove the strip ${row.title}`}
          title="Remove (Del)"
          onClick={() => removeStrip(r)}
        >
          ×
        </button>
      </div>
      {row.lines.map((each) => (
        <Value
          key={keyOf(each.signal)}
          own={each}
          single={row.lines.length === 1}
          remove={() => removeLine(r, each.signal)}
        />
      ))}
      <Brushed row={row} />
      <Grip r={r} />
    </div>
  );
}

/** Move a strip, and keep the focus on it. */
function refocus(event: KeyboardEvent, r: number, by: number): void {
  const list = (event.currentTarget as HTMLElement).parentElement;
  moveStrip(r, r + by);
  requestAnimationFrame(() => list?.querySelector<HTMLElement>(`[data-strip="${r + by}"]`)?.focus());
}

function Value({ own, single, remove }: { own: Line; single: boolean; remove: () => void }) {
  const key = keyOf(own.signal);
  const missing = drawn.value?.missing.get(key);
  const exact = cursor.value === null ? NaN : (sample.value?.values.get(key) ?? NaN);
  const under = hover.value === null ? NaN : valueUnder(drawn.value, own.signal, hover.value, settled.value.criteria);
  return (
    <div class="v" title={missing}>
      <i style={{ background: `var(--${own.colour})` }} />
      <span class="cut">{missing ? "not in this dataset" : own.label}</span>
      <span class="hv" title="Under the mouse: about the value there">
        {!missing && Number.isFinite(under) ? `≈ ${significant(under)}` : ""}
      </span>
      <b title="At the clicked sample">
        {missing ? "" : cursor.value === null ? "" : Number.isFinite(exact) ? significant(exact) : MISSING}
      </b>
      {!single && (
        <button
          class="x"
          tabIndex={-1}
          aria-label={`Remove ${own.label}`}
          title={`Remove ${own.label}`}
          onClick={remove}
        >
          ×
        </button>
      )}
    </div>
  );
}

/** Statistics of the first line over the brushed samples. */
function Brushed({ row }: { row: Row }) {
  const first = row.lines[0];
  const own = first && brushed.value?.statistics.get(keyOf(first.signal));
  if (!own || own.samples === 0) return null;
  const error = first.signal.kind === "error" || first.signal.kind === "start error";
  return (
    <div class="s">
      {error ? (
        <>
          RMSE {numberText(own.rms)}
          <br />
          mean {signed(own.mean ?? NaN)}
        </>
      ) : (
        <>
          {numberText(own.least)} … {numberText(own.greatest)}
          <br />
          mean {numberText(own.mean)}
        </>
      )}
    </div>
  );
}

/** The lower edge of a strip, dragged to change its height. */
function Grip({ r }: { r: number }) {
  const drag = (event: PointerEvent) => {
    event.preventDefault();
    event.stopPropagation();
    const grip = event.currentTarget as HTMLElement;
    const legend = grip.parentElement!;
    const unit = legend.clientHeight / rows.value[r]!.weight;
    let from = event.clientY;
    grip.setPointerCapture(event.pointerId);
    grip.onpointermove = (move) => {
      resizeStrip(r, (move.clientY - from) / unit);
      from = move.clientY;
    };
    grip.onpointerup = () => {
      grip.onpointermove = grip.onpointerup = null;
    };
  };
  return (
    <div
      class="grip"
      aria-hidden="true"
      onPointerDown={drag}
      onDragStart={(event) => {
        event.preventDefault();
        event.stopPropagation();
      }}
      draggable
    />
  );
}
