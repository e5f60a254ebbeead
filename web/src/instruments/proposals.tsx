// What the function needs and the project lacks, each with a button that adds it.

import { effect, signal } from "@preact/signals";
import { newest } from "../connection";
import { Icon } from "../icons";
import { setKeys, type Change } from "../settings";
import { request, settled } from "../store";

interface Proposal { title: string; changes: Change[] }
const proposals = signal<Proposal[]>([]);

const load = newest(async (_: number) => {
  const reply = await request("proposals");
  if (reply !== null) proposals.value = reply.head.proposals as Proposal[];
});

effect(() => {
  const { project, findings, revision } = settled.value;
  if (project !== null && findings.length > 0) load(revision);
  else proposals.value = [];
});

const add = (chosen: Proposal[]): Promise<void> => setKeys(chosen.flatMap((each) => each.changes), chosen.length === 1 ? `Added ${chosen[0]!.title}` : `Added ${chosen.length} proposals`);

export function Proposals() {
  const all = proposals.value;
  if (all.length === 0) return null;
  return (
    <div class="proposals" id="proposals">
      <div class="head mid"><h2>The function needs</h2><span class="sub">axes from the data, rounded</span><span class="right"><button class="btn small primary" id="add-all" onClick={() => add(all)}>Add all</button></span></div>
      {all.map((each) => <div class="ck i"><Icon name="plus" /><span class="grow">{each.title}</span><button class="btn small" onClick={() => add([each])}>Add</button></div>)}
    </div>
  );
}
