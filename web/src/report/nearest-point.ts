// The point of several layers that is nearest to the pointer.

import type { Area } from "../drawing/canvas";
import type { Points } from "./layers";

/** Return the layer and the number of the point, null if all are further away than `reach` pixels. */
export function nearestPoint<T extends Points>(
  layers: readonly T[],
  plot: Area,
  px: number,
  py: number,
  reach: number,
): [T, number] | null {
  let [best, hit]: [number, [T, number] | null] = [reach, null];
  for (const layer of layers) {
    for (let k = 0; k < layer.x.length; k++) {
      const distance = Math.hypot(plot.x(layer.x[k]!) - px, plot.y(layer.y[k]!) - py);
      if (distance < best) [best, hit] = [distance, [layer, k]];
    }
  }
  return hit;
}
