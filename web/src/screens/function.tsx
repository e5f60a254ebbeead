// The function: formula text, a Simulink or an ASCET model, or a file of another tool, with the values of its nodes at
// the cursor of the plots.

import { Footer, Key } from "../frame";
import { droppedFiles } from "../uploads";
import { Ascet } from "./function/ascet";
import { FileFunction } from "./function/file-function";
import { isFileFunction } from "./function/file-source";
import { FormulaText } from "./function/formula";
import { Simulink } from "./function/simulink";
import { esdl, simulink, takeFiles } from "./function/source";

export function FunctionScreen() {
  const drop = (event: DragEvent) => {
    event.preventDefault();
    void droppedFiles(event).then(takeFiles);
  };
  return (
    <>
      <div class="drop" onDragOver={(event) => event.preventDefault()} onDrop={drop}>
        {simulink.value ? (
          <Simulink />
        ) : esdl.value ? (
          <Ascet />
        ) : isFileFunction.value ? (
          <FileFunction />
        ) : (
          <FormulaText />
        )}
      </div>
      <Footer>
        {simulink.value ? (
          <>
            <Key keys={["↑", "↓"]} text="block" />
            <Key keys={["←", "→"]} text="fold" />
            <Key keys={["b"]} text="bind" />
            <Key keys={["p"]} text="make a parameter" />
          </>
        ) : esdl.value || isFileFunction.value ? (
          <Key keys={["Ctrl", "Z"]} text="undo" />
        ) : (
          <>
            <Key keys={["Alt", "↑ ↓"]} text="sample" />
            <Key keys={["F8"]} text="next message" />
            <Key keys={["Ctrl", "Z"]} text="undo" />
          </>
        )}
      </Footer>
    </>
  );
}
