// The function: formula text or a Simulink model, with the values of its nodes at the cursor of the plots.

import { Footer, Key } from "../frame";
import { FormulaText } from "./function/formula";
import { Simulink } from "./function/simulink";
import { simulink, takeFiles } from "./function/source";

export function Function() {
  const drop = (event: DragEvent) => {
    event.preventDefault();
    void takeFiles([...(event.dataTransfer?.files ?? [])]);
  };
  return (
    <>
      <div class="drop" onDragOver={(event) => event.preventDefault()} onDrop={drop}>{simulink.value ? <Simulink /> : <FormulaText />}</div>
      <Footer>{simulink.value ? <><Key keys={["↑", "↓"]} text="block" /><Key keys={["←", "→"]} text="fold" /><Key keys={["b"]} text="bind" /><Key keys={["p"]} text="make a parameter" /></> : <><Key keys={["Alt", "↑ ↓"]} text="sample" /><Key keys={["F8"]} text="next message" /><Key keys={["Ctrl", "Z"]} text="undo" /></>}</Footer>
    </>
  );
}
