// The screens, by the names that addresses have.

export const SCREENS = [
  "data",
  "function",
  "parameters",
  "optimization",
  "results",
  "plots",
  "files",
  "missing",
  "design",
  "control-unit",
  "start",
] as const;
export type Screen = (typeof SCREENS)[number];
