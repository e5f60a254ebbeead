// Settings of the function: keys of [model].

import { NumberField } from "../../fields";
import { Fold } from "./fold";

export function FunctionSettings() {
  return (
    <Fold title="Settings" sub="of the function" name="settings">
      <dl class="facts pad">
        <dt>step</dt><dd><NumberField path={["model", "step"]} label="Step of the model" help="Time step in s of a model with memory; typical 0.01 to 0.2. If it is finer than the data, inputs are interpolated." placeholder="of the data" unit="s" width={92} /></dd>
      </dl>
    </Fold>
  );
}
