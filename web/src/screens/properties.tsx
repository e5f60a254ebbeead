// What the fit may do with a parameter: free or fixed, bounds, smoothness, limits of its slope, locks.

import { plain } from "../drawing/numbers";
import { LogSlider, PairField, Segment } from "../fields";
import type { EditedTable } from "../replies";
import { setKeys, settings, valueAt } from "../settings";
import { state } from "../store";

const DIRECTIONS = ["x", "y", "z", "w"];

export function Properties({ own }: { own: EditedTable }) {
  const path = (...keys: (string | number)[]) => ["parameters", own.name, ...keys];
  const parameter = state.value.parameters.find((p) => p.name === own.name);
  const lock = valueAt(path("lock"));
  const pins = valueAt(path("pin"));
  return (
    <>
      <div class="head top">
        <h2 class="cut" title={own.name}>
          {own.name}
        </h2>
        <span class="right q gives">what the fit may do</span>
      </div>
      <div class="props">
        <Prop label="Fit">
          <Segment
            label="Fit"
            options={["free", "fixed"]}
            chosen={parameter?.free ? "free" : "fixed"}
            choose={(option) => setKeys([[path("free"), option === "free"]], `${own.name}: ${option}`)}
          />
        </Prop>
        <Prop label="Bounds">
          <PairField path={path("bounds")} label={`Bounds of ${own.name}`} />
        </Prop>
        {own.axes.length > 0 && (
          <Prop label="Smoothness">
            <LogSlider path={path("smoothness")} label={`Smoothness of ${own.name}`} />
          </Prop>
        )}
        {own.axes.map((axis, k) => (
          <Prop label={`d/d ${axis.input || DIRECTIONS[k]}`}>
            <PairField
              path={path("gradient", DIRECTIONS[k]!)}
              label={`Slope of ${own.name} along ${axis.input || DIRECTIONS[k]}`}
            />
          </Prop>
        ))}
        {pins !== undefined && Array.isArray(pins) && (
          <Prop label="Pinned">
            <span class="ink">{pins.length}</span>
            <span class="q">value{pins.length > 1 ? "s" : ""}</span>
            <button class="btn small" onClick={() => setKeys([[path("pin"), null]], `${own.name}: no pins`)}>
              Remove
            </button>
          </Prop>
        )}
        <Prop label="Without data">
          <span class="ink">{parameter?.withoutData ?? 0}</span>
          <span class="q">of {own.values.length}</span>
          {lock === "no-data" ? (
            <button class="btn small" onClick={() => setKeys([[path("lock"), null]], `${own.name}: not locked`)}>
              Unlock
            </button>
          ) : (
            <button
              class="btn small"
              disabled={!parameter?.withoutData}
              onClick={() => setKeys([[path("lock"), "no-data"]], `${own.name}: values without data are locked`)}
            >
              Lock
            </button>
          )}
        </Prop>
        {own.axes.map((axis, k) => (
          <Prop label={`${DIRECTIONS[k]} ${axis.input}`}>
            <span class="q">
              {axis.points.length}, {plain(axis.points[0]!, 4)} … {plain(axis.points.at(-1)!, 4)}
            </span>
          </Prop>
        ))}
      </div>
      <div class="file">
        <div class="q">writes to {state.value.project?.path.split(/[\\/]/).at(-1)}</div>
        <pre class="mono">{section(own.name)}</pre>
      </div>
    </>
  );
}

function Prop({ label, children }: { label: string; children: preact.ComponentChildren }) {
  return (
    <div class="prop">
      <span class="q cut">{label}</span>
      <span class="row">{children}</span>
    </div>
  );
}

/** The section of the parameter as it stands in the project file. */
function section(name: string): string {
  const lines = settings.value.text.split(/\r?\n/);
  const begin = lines.findIndex((line) => line.replace(/\s|"/g, "").startsWith(`[parameters.${name}]`));
  if (begin < 0) return "";
  const length = lines.slice(begin + 1).findIndex((line) => line.startsWith("["));
  return lines
    .slice(begin, length < 0 ? undefined : begin + 1 + length)
    .filter((line) => line.trim())
    .map((line) => line.replace(/\s+#.*$/, ""))
    .slice(0, 6)
    .join("\n");
}
