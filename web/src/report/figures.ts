// The figures of a report as the Python side writes them (`report/figures.py`); null is a number that is not known.

import type { Term } from "../drawing/term";
import type { CodedNumbers } from "./coded-numbers";

export type Values = (number | null)[];

export interface AxisData {
  title: string;
  unit: string;
  points: number[];
}

/** What a strip shows when it is zoomed; errors are missing if they are differences of samples. */
export interface StripDetail {
  whole: boolean;
  size: number; // samples of a group
  x: CodedNumbers; // one for each sample or group
  traces: Partial<Record<"measured" | "before" | "after" | "errorBefore" | "error", CodedNumbers>>;
}

export interface Signal {
  name: string;
  unit: string;
  kind: "input" | "node";
  values: CodedNumbers;
}

/** Inputs and nodes of the function over a dataset. */
export interface DatasetSignals {
  whole: boolean;
  size: number;
  leftOut: number;
  x: CodedNumbers;
  signals: Signal[];
}

export interface StripFigure {
  kind: "strip";
  dataset: string;
  detail?: StripDetail;
  whole: boolean; // else each group of samples has two points: minimum and maximum
  time: boolean;
  x: number[];
  xTitle: string;
  xUnit: string;
  pieces: number[]; // where recordings begin
  unit: string;
  measured: Values;
  before: Values;
  after: Values;
  errorBefore: Values;
  error: Values;
}

export interface ScatterFigure {
  kind: "scatter";
  unit: string;
  number: number[];
  measured: Values;
  before: Values;
  after: Values;
}

export interface Bins {
  ends: [number, number];
  counts: number[];
  beyond: number;
}
export interface HistogramsFigure {
  kind: "histograms";
  unit: string;
  own: { before: Bins; after: Bins };
  equal: { before: Bins; after: Bins };
}

export interface AutocorrelationFigure {
  kind: "autocorrelation";
  unit: string;
  lags: number[];
  values: Values;
  band: number;
}

export interface Stage {
  name: string;
  start: number;
  x: number[];
  cost: Values;
  rmse: Values;
}
export interface ConvergenceFigure {
  kind: "convergence";
  before: number | null;
  stages: Stage[];
}

type Cells<T> = T[] | T[][]; // of a curve or of a map
export interface CellErrors {
  samples: Cells<number>;
  mean: Cells<number | null>;
  rmse: Cells<number | null>;
}
export interface CellsFigure {
  kind: "cells";
  unit: string;
  axes: AxisData[];
  uses: Record<string, CellErrors>;
}

/** A table, flat in C order. A standard deviation of -1 is not determined. */
export interface ParameterFigure {
  kind: "parameter";
  name: string;
  unit: string;
  type: string;
  axes: AxisData[];
  before: Values;
  after: Values;
  bound: number[];
  locked: number[];
  deviation: Values | null;
  samples: number[] | null;
  informed: number[] | null;
  bySmoothness: number[] | null;
}

/** A proposed term, and the errors without and with it. */
export interface TermFigure extends Term {
  kind: "term";
  form: "add" | "multiply" | "lag" | "offset";
  node: string;
  parameter: string;
  edges: number[];
  before: Values;
  after: Values;
  x: number[];
  error: number[];
}

export type Figure =
  | StripFigure
  | ScatterFigure
  | HistogramsFigure
  | AutocorrelationFigure
  | ConvergenceFigure
  | CellsFigure
  | ParameterFigure
  | TermFigure;

/** Return numbers with NaN for those that are not known. */
export const numbers = (values: readonly (number | null)[]): number[] => values.map((value) => value ?? NaN);

export const equal = (a: Values, b: Values): boolean => a.length === b.length && a.every((value, k) => value === b[k]);
