// What to drive or to measure, with what it settles, and its files; beside it, what no such measurement settles.

import {
  computing,
  existing,
  exportDesign,
  type Format,
  format,
  outcome,
  recorded,
  segment,
  written,
} from "../../design";
import { count, counted, MISSING, plain, significant, tableFormat } from "../../drawing/numbers";
import { Segment } from "../../fields";
import { Icon } from "../../icons";
import { jump } from "../../navigation";
import type { FoundDesign } from "../../replies";
import { screen, state } from "../../store";
import { address } from "../../uploads";

export function ListPane() {
  const own = outcome.value;
  return (
    <section class="pane chosen" aria-label="List">
      <div class="head">
        <h2>{title(own)}</h2>
        {own?.stopped.length ? (
          <span class="sub warn" id="design-part">
            {partText(own)}
          </span>
        ) : (
          <span class="sub">
            {own?.segments.length ? "most useful first; each is judged after those above it" : ""}
          </span>
        )}
      </div>
      <div class="rows">{own !== null && <Rows own={own} />}</div>
      {own !== null && <Export own={own} />}
    </section>
  );
}

function title(own: FoundDesign | null): string {
  if (own === null) return recorded.value === "points" ? "Measure these" : "Drive these";
  if (own.segments.length) return "Drive these";
  if (own.points.length) return "Measure these";
  return own.planned.length ? "Planned manoeuvres" : "These can go";
}

/** How many are chosen of how many, of a choice that goes on, or that was stopped. */
function partText(own: FoundDesign): string {
  const [chosen, wanted] = own.stopped;
  return computing.value ? `${chosen} of ${wanted} so far` : `stopped after ${chosen} of ${wanted}`;
}

function Rows({ own }: { own: FoundDesign }) {
  if (own.segments.length) return <Segments own={own} />;
  if (own.points.length) return <Points own={own} />;
  if (own.planned.length)
    return (
      <table class="list sg" id="planned">
        <tbody>
          {own.planned.map((each) => (
            <tr>
              <td>
                <b>{each.name}</b>
              </td>
              <td class="num">{significant(each.duration, 3)} s</td>
              <td class="q">{each.channels.join(", ")}</td>
            </tr>
          ))}
        </tbody>
      </table>
    );
  if (own.drop.length === 0) return <p class="pad q">All recordings add something.</p>;
  return (
    <table class="list sg" id="dropped">
      <tbody>
        {own.drop.map((name, k) => (
          <tr>
            <td class="num q">{k + 1}</td>
            <td>
              <b>{name}</b>
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function Badge({ k }: { k: number }) {
  return <span class={`bdg ${k === segment.value ? "on" : ""}`}>{k + 1}</span>;
}

const pick = (k: number) => () => {
  segment.value = k;
};

function Segments({ own }: { own: FoundDesign }) {
  return (
    <table class="list sg" id="segments">
      <thead>
        <tr>
          <th />
          <th>recording</th>
          <th class="num">from</th>
          <th class="num">to</th>
          <th>settles</th>
          <th class="num" title="Mean variance of prediction over the use after it and those above it, of that now">
            variance left
          </th>
        </tr>
      </thead>
      <tbody>
        {own.segments.map((each, k) => (
          <tr class={k === segment.value ? "on" : ""} data-segment={k} onClick={pick(k)}>
            <td>
              <Badge k={k} />
            </td>
            <td class="ink cut" title={each.file}>
              {each.file.split("/").at(-1)}
            </td>
            <td class="num">{plain(each.begin, 6)} s</td>
            <td class="num">{plain(each.end, 6)} s</td>
            <td class="q cut" title={each.settles}>
              {each.settles || MISSING}
            </td>
            <td class="num ink">{each.left === null ? MISSING : `${significant(100 * each.left, 3)} %`}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function Points({ own }: { own: FoundDesign }) {
  const formats = own.channels.map((_, k) => tableFormat(own.points.map((each) => each.channels[k]!)));
  return (
    <table class="list sg" id="points">
      <thead>
        <tr>
          <th />
          {own.channels.map((name) => (
            <th class="num">{name}</th>
          ))}
          <th class="num">block</th>
          <th>kind</th>
        </tr>
      </thead>
      <tbody>
        {own.points.map((each, k) => (
          <tr class={k === segment.value ? "on" : ""} data-point={k} onClick={pick(k)}>
            <td>
              <Badge k={k} />
            </td>
            {each.channels.map((value, channel) => (
              <td class="num ink">{formats[channel]!(value)}</td>
            ))}
            <td class="num">{each.block}</td>
            <td class="q">{each.kind}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function Export({ own }: { own: FoundDesign }) {
  const facts = own.segments.length
    ? `${counted(own.segments.length, "segment")}, each ${significant(own.warmup, 3)} s earlier to settle`
    : own.points.length
      ? counted(own.points.length, "point")
      : "";
  return (
    <div class="frow" id="export-row">
      <button class="btn primary" id="export-design" onClick={() => void exportDesign(false)}>
        Export measure-next.{format.value}
      </button>
      <Segment
        label="Format"
        options={own.formats.map((each) => each.toUpperCase())}
        chosen={format.value.toUpperCase()}
        choose={(option) => {
          format.value = option.toLowerCase() as Format;
          existing.value = "";
        }}
      />
      {existing.value ? (
        <span class="warn grow" id="existing-design">
          {existing.value} exists.{" "}
          <button class="btn small" id="replace-design" onClick={() => void exportDesign(true)}>
            Replace it
          </button>
        </span>
      ) : written.value ? (
        <span class="good grow" id="written-design">
          Written:{" "}
          <a href={address(written.value)} download>
            {written.value}
          </a>
        </span>
      ) : (
        <span class="q cut grow">{facts}</span>
      )}
    </div>
  );
}

/** What the design leaves open, with the ways to what else settles it. */
export function OpenPane() {
  const own = outcome.value;
  const settled = own?.tables.filter((row) => row.settled > 0) ?? [];
  return (
    <section class="pane open2" aria-label="What is left open">
      <div class="head">
        <h2>What {recorded.value === "points" ? "no point" : "no drive"} settles</h2>
      </div>
      {own?.remarks.map((each) => (
        <div class="sy">
          <span class={each.severity === "remark" ? "q" : "warn"}>
            <Icon name="warning" />
          </span>
          <div>
            <p>
              {each.message}. {each.remedy}
            </p>
            {each.remedy.includes("kennfeld propose") && (
              <Way
                text="What is missing?"
                go={() => {
                  screen.value = "missing";
                }}
              />
            )}
            {each.remedy.includes("length") && <Way text="Length of a segment" go={() => jump("design", "length")} />}
          </div>
        </div>
      ))}
      {own?.unsettled.map((text) => (
        <div class="sy" data-unsettled>
          <span class="warn">
            <Icon name="warning" />
          </span>
          <div>
            <p>{text}</p>
            <Way
              text="Remedies: pin, lock, smooth"
              go={() => {
                screen.value = "results";
              }}
            />
          </div>
        </div>
      ))}
      {own?.sentences.map((text) => (
        <div class="sy">
          <span class="q">
            <Icon name="done" />
          </span>
          <p>{text}</p>
        </div>
      ))}
      {settled.map((row) => (
        <div class="sy">
          <span class="good">
            <Icon name="done" />
          </span>
          <p>
            <b>{row.name}</b>: the deviation of {count(row.settled)} values falls to less than half.
          </p>
        </div>
      ))}
      {own === null && (
        <p class="pad q">{state.value.runs.length ? "Nothing has been proposed yet." : "No run yet."}</p>
      )}
      {own !== null && own.unsettled.length === 0 && own.remarks.length === 0 && (
        <p class="pad q">Nothing that the data leave open stays open, as far as the last fit knows.</p>
      )}
    </section>
  );
}

function Way({ text, go }: { text: string; go: () => void }) {
  return (
    <button class="btn small" onClick={go}>
      {text}
    </button>
  );
}
